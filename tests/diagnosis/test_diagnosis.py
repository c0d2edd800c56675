"""Diagnosis: what was planted is found, nothing where nothing is, and what no effect explains is called that."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.data import UnusableData, as_recordings, sample_windows
from idapt_pl.diagnosis.noise import (
    Noise,
    estimate_noise,
    initial_sensitivity,
    rounding_noise,
    shrink_to_kind,
    whiten,
    whitener,
)
from idapt_pl.diagnosis.search import diagnose, split_episodes
from idapt_pl.diagnosis.settings import SearchSettings
from idapt_pl.diagnosis.simulator import Simulator
from idapt_pl.diagnosis.verdict import correlation
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import ActuatorDelay, SensorGain

ARM = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom name="u" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.6" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.02"/>
        <geom name="l" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.4" contype="0" conaffinity="0"/>
      </body></body>
  </worldbody>
  <actuator><motor name="s" joint="shoulder"/><motor name="e" joint="elbow"/></actuator>
</mujoco>"""
NOISE_Q, NOISE_V, DT, SKIP = 1e-3, 1e-2, 0.02, 5


def record(
    xml=ARM, delay=0, push=None, episodes=6, steps=80, size=1.0, velocities=True, seed=0, noise=(NOISE_Q, NOISE_V)
):
    """Recordings of an arm: commands late by whole physics steps, ``push(time)`` a torque on the shoulder."""
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(seed)
    made = []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[:], queue = rng.normal(size=model.nq) * 0.3, [np.zeros(model.nu)] * delay
        actions = size * np.repeat(rng.normal(size=(steps // 4, model.nu)), 4, 0).clip(-1, 1)
        q, v = [data.qpos.copy()], [data.qvel.copy()]
        for a in actions:
            for _ in range(SKIP):
                queue.append(a)
                data.ctrl[:] = queue.pop(0)
                data.qfrc_applied[0] = push(data.time) if push else 0.0
                mujoco.mj_step(model, data)
            q.append(data.qpos.copy()), v.append(data.qvel.copy())
        seen = {"qpos": np.array(q) + noise[0] * rng.normal(size=(steps + 1, model.nq))}
        if velocities:
            seen["qvel"] = np.array(v) + noise[1] * rng.normal(size=(steps + 1, model.nv))
        made.append(Episode(actions.astype(np.float32), seen))
    return Trajectories(tuple(made), DT)


def found(data, **settings):
    diagnosis = diagnose(mujoco.MjSpec.from_string(ARM), data, **settings)
    return diagnosis, {(e["effect"], e["target"]): e for e in diagnosis.report["effects"]}


def test_nothing_is_found_where_nothing_is_missing():
    diagnosis, effects = found(record())
    assert (diagnosis.verdict, effects) == ("no_missing_effect", {})
    assert diagnosis.report["error"]["before"] == pytest.approx(1.0, abs=0.15), "a right model leaves the noise"


@pytest.mark.parametrize(
    ("edit", "label", "parameter", "truth"),
    [
        (('name="elbow" axis="0 1 0" damping="0.02"', 'name="elbow" axis="0 1 0" damping="0.06"'),
         ("joint_damping", "elbow"), "damping", 0.06),
        (('<motor name="s" joint="shoulder"', '<motor name="s" gear="0.8" joint="shoulder"'),
         ("actuator_gain", "s"), "gain", 0.8),
        (('name="shoulder" axis="0 1 0"', 'name="shoulder" frictionloss="0.08" axis="0 1 0"'),
         ("joint_frictionloss", "shoulder"), "frictionloss", 0.08),
    ],
    ids=["damping", "gain", "frictionloss"],
)  # fmt: skip
def test_a_hidden_change_of_the_model_is_named_and_measured(edit, label, parameter, truth):
    assert edit[0] in ARM
    diagnosis, effects = found(record(ARM.replace(*edit)))
    assert (diagnosis.verdict, set(effects)) == ("effects_found", {label})
    value = effects[label]["parameters"][parameter]
    assert value["estimate"] == pytest.approx(truth, rel=0.05)
    assert value["ci95"][0] < value["estimate"] < value["ci95"][1]
    error = diagnosis.report["error"]
    assert error["after"] < 1.2 < error["before"]


def test_a_delay_is_named_and_its_twin_is_listed():
    _, effects = found(record(delay=4))
    assert set(effects) == {("actuator_delay", "*")}
    delay = effects["actuator_delay", "*"]
    assert delay["parameters"]["delay"]["estimate"] == pytest.approx(0.016, abs=0.003)
    assert "sensor_delay" in {e["effect"] for e in delay["equivalent"]}


def test_an_effect_outside_the_library_is_left_unexplained():
    diagnosis, _ = found(record(push=lambda t: 0.8 * np.sin(2 * np.pi * 1.7 * t)))
    assert diagnosis.verdict == "unexplained_residual"
    assert "shoulder" in diagnosis.report["signature"] or "elbow" in diagnosis.report["signature"]


BASE = (
    ARM.replace(
        '<body name="upper">',
        '<body name="base"><joint name="rail" type="slide" axis="1 0 0" damping="0.5"/>'
        '<geom name="b" type="sphere" size="0.05" mass="1" contype="0" conaffinity="0"/><body name="upper">',
    )
    .replace("</body></body>", "</body></body></body>")
    .replace('axis="0 1 0"', 'axis="0 1 0" armature="0.01"')
)
"""The arm on a cart that nothing drives, whose joint has no armature."""


@pytest.mark.parametrize(("armature", "label"), [
    ({"shoulder": 0.03, "elbow": 0.03}, ("joint_armature", "actuated")),
    ({"shoulder": 0.01, "elbow": 0.03}, ("joint_armature", "elbow")),
    ({"shoulder": 0.01, "elbow": 0.01}, None),
], ids=["all motors", "one motor", "nothing"])  # fmt: skip
def test_what_all_motors_share_is_told_from_what_one_of_them_has(armature, label):
    spec = mujoco.MjSpec.from_string(BASE)
    for name, value in armature.items():
        spec.joint(name).armature = value
    spec.compile()
    recorded = record(spec.to_xml())
    kinds = ["joint_armature", "joint_damping", "body_mass", "actuator_gain", "actuator_delay"]
    diagnosis = diagnose(mujoco.MjSpec.from_string(BASE), recorded, candidates=kinds)
    effects = {(e["effect"], e["target"]): e for e in diagnosis.report["effects"]}
    assert set(effects) == ({label} if label else set())
    if label:
        assert effects[label]["parameters"]["armature"]["estimate"] == pytest.approx(0.03, rel=0.05)


def test_positions_alone_are_enough_for_a_large_effect():
    edit = ARM.replace('name="elbow" axis="0 1 0" damping="0.02"', 'name="elbow" axis="0 1 0" damping="0.1"')
    _, effects = found(record(edit, velocities=False), candidates=["joint_damping", "joint_armature", "actuator_gain"])
    assert ("joint_damping", "elbow") in effects


def test_very_short_episodes_of_positions_are_refused():
    with pytest.raises(UnusableData, match="too short: half of them last 4 control steps"):
        found(record(episodes=30, steps=4, velocities=False))


def test_declared_effects_are_not_found_again():
    edit = ARM.replace('name="elbow" axis="0 1 0" damping="0.02"', 'name="elbow" axis="0 1 0" damping="0.06"')
    diagnosis, effects = found(record(edit), declared=[JointDamping("elbow", 0.06)])
    assert (diagnosis.verdict, effects) == ("no_missing_effect", {})


def test_the_same_data_and_seed_give_the_same_report():
    data = record(ARM.replace('damping="0.02"', 'damping="0.06"'))
    reports = [found(data, candidates=["joint_damping", "body_mass"])[0].report for _ in range(2)]
    for r in reports:
        r.pop("runtime_s")
    assert reports[0] == reports[1]


# --- laws ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def right():
    """A simulator with the right model, its windows, residuals and sensitivities."""
    spec, trajectories = mujoco.MjSpec.from_string(ARM), record(episodes=12)
    data, velocities = as_recordings(spec.copy().compile(), trajectories)
    sim = Simulator(spec, data, velocities)
    windows = sample_windows(data, np.arange(12), 5, 5, 1000, 0)
    residual = sim.residual((), windows)
    size = np.repeat([NOISE_Q, NOISE_V], 2)
    return sim, windows, residual, initial_sensitivity(sim, (), windows, size)


def test_noise_is_estimated(right):
    sim, *_ = right
    noise = estimate_noise(sim, (), sample_windows(sim.data, np.arange(12), 2, 2, 200, 0))
    np.testing.assert_allclose(noise.sensors, [NOISE_Q] * 2 + [NOISE_V] * 2, rtol=0.25)


def test_a_sensor_that_counts_has_the_noise_of_rounding_even_at_rest():
    rng, count = np.random.default_rng(0), 2 * np.pi / 4096
    resting = np.round((np.sin(np.linspace(0, 1, 400)) * (np.arange(400) > 300))[:, None] / count) * count
    assert rounding_noise([resting]) == pytest.approx(count / 12**0.5)
    assert rounding_noise([rng.normal(size=(400, 1))]) == 0.0, "no counts, no rounding"


def test_no_sensor_is_taken_to_be_much_better_than_others_of_its_kind():
    model = mujoco.MjModel.from_xml_string(ARM)
    sigma = shrink_to_kind(model, np.array([1e-3, 1e-9, 1e-2, 2e-2]))
    assert sigma == pytest.approx([1e-3, 2.5e-4, 1e-2, 2e-2]), "half the median of the kind"


def test_intervals_allow_for_a_sensor_whose_gain_is_not_known():
    """All of the elbow's readings 6 % too large: the estimate is off, by what the interval allows for and no more."""
    data = record(ARM.replace('name="elbow" axis="0 1 0" damping="0.02"', 'name="elbow" axis="0 1 0" damping="0.06"'))
    factor = np.array([1.0, 1.06])
    episodes = (replace(e, observations={k: v * factor for k, v in e.observations.items()}) for e in data)
    stretched = replace(data, episodes=tuple(episodes))
    both = np.repeat([NOISE_Q, NOISE_V], 2)

    def damping(recording, *systematic):
        how = {"noise": Noise(both, both, systematic), "candidates": ["joint_damping"]}
        return found(recording, **how)[1]["joint_damping", "elbow"]["parameters"]["damping"]

    truth, off, allowed = damping(data), damping(stretched), damping(stretched, SensorGain("elbow", 1.06))
    assert off["ci95"][1] < 0.06 or off["ci95"][0] > 0.06, "what the sensor's noise alone allows misses"
    assert off["estimate"] == allowed["estimate"], "nothing but the interval is another"
    assert allowed["ci95"][0] < 0.06 < allowed["ci95"][1]
    narrow, wide = (np.diff(p["ci95"])[0] / 2 for p in (off, allowed))
    assert np.sqrt(wide**2 - narrow**2) / 1.96 == pytest.approx(abs(off["estimate"] - truth["estimate"]), rel=0.25)


def test_noise_is_not_mistaken_for_a_missing_effect():
    """What the model gets wrong lasts longer than a control step, and does not count as noise."""
    spec = mujoco.MjSpec.from_string(ARM)
    data, velocities = as_recordings(
        spec.copy().compile(), record(ARM.replace('joint="shoulder"', 'joint="shoulder" gear="0.7"'))
    )
    sim = Simulator(spec, data, velocities)
    noise = estimate_noise(sim, (), sample_windows(data, np.arange(6), 2, 2, 200, 0))
    step = sim.residual((), sample_windows(data, np.arange(6), 1, 1, 200, 0))[:, 0]
    np.testing.assert_allclose(noise.sensors[:2], NOISE_Q, rtol=0.3)
    assert (noise.sensors[2:] < 0.5 * step.std(0)[2:]).all()


def test_residuals_of_the_right_model_are_white_after_whitening(right):
    sim, _, residual, at = right
    z = whiten(whitener(at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), sim.compared), residual)
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)
    correlation = np.corrcoef(z.T) - np.eye(z.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(len(z))


def test_what_was_not_measured_does_not_count_and_the_rest_is_white_without_it(right):
    _, _, residual, at = right
    elsewhere = residual.copy()
    elsewhere[..., 0] += 1e3
    W = whitener(at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), np.array([False, True, True, True]))
    z = whiten(W, residual)
    assert z.shape[1] == 3 * residual.shape[1] and np.array_equal(z, whiten(W, elsewhere))
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)


def test_without_noise_the_right_model_predicts_the_recording():
    """Controls are held as they were: a prediction from exact states is exact."""
    trajectories = record(episodes=2, noise=(0.0, 0.0))
    spec = mujoco.MjSpec.from_string(ARM)
    data, velocities = as_recordings(spec.copy().compile(), trajectories)
    sim = Simulator(spec, data, velocities)
    windows = sample_windows(data, np.arange(2), 5, 5, 1000, 0)
    assert np.abs(sim.residual((), windows)).max() < 1e-5  # actions are float32
    late = sim.residual((ActuatorDelay("*", 0.01),), windows)
    assert np.abs(late).max() > 1e-3


def test_windows_stay_inside_episodes_and_do_not_overlap(right):
    sim, windows, *_ = right
    for e in np.unique(windows.episode):
        starts = np.sort(windows.start[windows.episode == e])
        assert starts[-1] + windows.offsets[-1] <= len(sim.data[e])
        assert (np.diff(starts) >= windows.offsets[-1]).all()


def test_split_holds_every_fourth_episode_out_and_never_shares():
    fit, held = split_episodes(np.ones(9), None, None)
    assert len(held) >= 2 and sorted([*fit, *held]) == list(range(9))
    assert split_episodes(np.ones(4), None, [1])[0].tolist() == [0, 2, 3]
    with pytest.raises(ValueError, match="both to be fitted and held out"):
        split_episodes(np.ones(4), [0, 1], [1])
    with pytest.raises(ValueError, match="no episode 7"):
        split_episodes(np.ones(4), [7], None)
    with pytest.raises(ValueError, match="at least two are needed"):
        split_episodes(np.ones(1), None, None)


def test_both_parts_have_calm_and_lively_episodes():
    """Recordings often take turns: every fourth in order would hold out one kind of motion."""
    _, held = split_episodes(np.tile([1.0, 2.0, 3.0, 0.1], 4), None, None)
    assert {int(e) % 4 for e in held} == {0, 1, 2, 3}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda q, a: (q[:, :1], a), r"episode_0: qpos has shape \(81, 1\), but the model has 2"),
        (lambda q, a: (np.where(np.arange(81)[:, None] == 7, np.nan, q), a), "qpos holds NaN .* first in row 7"),
        (lambda q, a: (q, a[:, :1]), r"actions has shape \(80, 1\), but the model has 2 actuators"),
    ],
    ids=["shape", "nan", "actions"],
)
def test_unusable_recordings_are_refused_by_name(spoil, message):
    good = record(episodes=2)
    e = good.episodes[0]
    qpos, actions = spoil(e.observations["qpos"], e.actions)
    bad = Episode(actions, {"qpos": qpos, "qvel": e.observations["qvel"]})
    with pytest.raises(UnusableData, match=message):
        diagnose(mujoco.MjSpec.from_string(ARM), Trajectories((bad, *good.episodes[1:]), DT))


def test_velocities_that_come_late_are_not_used():
    """A filtered speed register would otherwise be blamed on friction or on a sensor."""
    prompt = record()
    late = [
        Episode(e.actions, {**e.observations, "qvel": e.observations["qvel"][[0, 0, *range(80 - 1)]]})
        for e in prompt.episodes
    ]
    model = mujoco.MjModel.from_xml_string(ARM)
    assert as_recordings(model, prompt)[1], "prompt velocities are used"
    assert not as_recordings(model, Trajectories(tuple(late), DT))[1]


BOX = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"{medium}/>
  <worldbody>
    <body name="box" pos="0 0 20"><freejoint name="free"/>
      <geom name="b" type="box" size="0.1 0.2 0.05" mass="{mass}" contype="0" conaffinity="0"/>
      <body name="arm" pos="0.1 0 0"><joint name="swing" type="ball" damping="0.01"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.3" contype="0" conaffinity="0"/></body>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="free" gear="0 0 1 0 0 0"/><motor name="spin" joint="free" gear="0 0 0 0.1 0 0"/>
  </actuator>
</mujoco>"""


def flights(mass, medium="", episodes=6, steps=60):
    """A tumbling box with a limb on a ball joint, thrown and pushed about."""
    model, rng, made = (
        mujoco.MjModel.from_xml_string(BOX.format(mass=mass, medium=medium)),
        np.random.default_rng(1),
        [],
    )
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qvel[:] = rng.normal(size=model.nv) * 2
        actions = np.repeat(rng.normal(size=(steps // 4, 2)) * 20, 4, 0)
        rows = [(data.qpos.copy(), data.qvel.copy())]
        for a in actions:
            data.ctrl[:] = a
            mujoco.mj_step(model, data, 4)
            rows.append((data.qpos.copy(), data.qvel.copy()))
        q, v = (np.array(x) for x in zip(*rows, strict=True))
        for row in q:
            mujoco.mj_integratePos(model, row, rng.normal(size=model.nv) * 1e-3, 1.0)
        made.append(Episode(actions.astype(np.float32), {"qpos": q, "qvel": v + 1e-2 * rng.normal(size=v.shape)}))
    return Trajectories(tuple(made), 0.02)


@pytest.mark.parametrize(
    ("mass", "medium", "expected"),
    [(2.0, "", set()), (2.8, "", {"body_mass"}), (2.0, ' density="15"', {"fluid_drag"})],
    ids=["nothing", "mass", "drag"],
)
def test_free_and_ball_joints(mass, medium, expected):
    spec = mujoco.MjSpec.from_string(BOX.format(mass=2.0, medium=""))
    diagnosis = diagnose(spec, flights(mass, medium), candidates=["body_mass", "fluid_drag", "actuator_gain"])
    assert {e["effect"] for e in diagnosis.report["effects"]} == expected
    assert diagnosis.report["error"]["after"] == pytest.approx(1.0, abs=0.15)


def test_what_the_recordings_do_not_excite_is_called_that():
    """A joint that never turns about its axis says nothing of the drag on it, however small the residual."""
    still = ARM.replace('<motor name="e" joint="elbow"/>', '<motor name="e" joint="elbow" gear="1e-6"/>').replace(
        "<option timestep", '<option gravity="0 0 0" timestep'
    )
    spec = mujoco.MjSpec.from_string(
        still.replace('joint name="elbow" axis="0 1 0"', 'joint name="elbow" axis="0 0 1"')
    )
    trajectories = record(spec.to_xml(), size=0.0, episodes=4, noise=(1e-3, 1e-2))
    report = diagnose(spec, trajectories, candidates=["joint_drag", "actuator_gain"]).report
    assert report["verdict"] in ("insufficient_excitation", "no_missing_effect")
    reasons = [c["rejected_because"] for c in report["candidates"]]
    assert any("not excited by these recordings" in r for r in reasons)


def test_numerics_are_reported_as_what_differs():
    """The same integrator with another time step is not another integrator. They can be kept as they are."""
    coarse, data = ARM.replace('timestep="0.004"', 'timestep="0.02"'), record(noise=(1e-5, 1e-4))

    def found(**settings):
        spec = mujoco.MjSpec.from_string(coarse)
        report = diagnose(spec, data, candidates=["body_mass"], settings=SearchSettings(**settings)).report
        return [e for e in report["effects"] if e["effect"] == "numerics"]

    (numerics,) = found()
    assert set(numerics["parameters"]) == {"timestep"}
    assert found(numerics=False) == []


def test_what_a_residual_goes_along_with_is_a_share_of_it():
    rng = np.random.default_rng(0)
    x, constant = rng.normal(size=500), np.ones(500)
    assert correlation(x, 3 * x + 7) == pytest.approx(1) and correlation(-x, x) == pytest.approx(-1)
    assert correlation(constant, constant * -4e-9) == pytest.approx(-1), "a residual that is the same everywhere"
    assert abs(correlation(constant, x)) < 0.1 and abs(correlation(x, rng.normal(size=500))) < 0.1
    assert correlation(x, constant) == 0 and correlation(0 * x, x) == 0


LOOSE = ARM.replace(
    '<joint name="elbow" axis="0 1 0" damping="0.02"/>',
    '<joint name="elbow" axis="0 1 0" damping="0.02" armature="0.004"/><joint name="slack" axis="0 1 0" limited="true" '
    'range="-2 2" solreflimit="0.008 1"/>',
)
"""The elbow's gear has four degrees of play."""


def test_backlash_is_found_by_where_the_link_must_have_been():
    nominal = ARM.replace(
        'name="elbow" axis="0 1 0" damping="0.02"', 'name="elbow" axis="0 1 0" damping="0.02" armature="0.004"'
    )
    hidden = record(LOOSE, episodes=8, noise=(0.0, 0.0))
    rng, episodes = np.random.default_rng(1), []
    for e in hidden:  # what encoders on the links show: the motor's angle and the link's in its play together
        seen = {}
        for name, noise in (("qpos", NOISE_Q), ("qvel", NOISE_V)):
            x = e.observations[name]
            seen[name] = np.stack([x[:, 0], x[:, 1] + x[:, 2]], 1) + noise * rng.normal(size=(len(x), 2))
        episodes.append(Episode(e.actions, seen))
    diagnosis = diagnose(
        mujoco.MjSpec.from_string(nominal), Trajectories(tuple(episodes), DT),
        candidates=["joint_backlash", "joint_damping", "joint_frictionloss", "actuator_gain"],
    )  # fmt: skip
    first = diagnosis.report["effects"][0]
    assert (first["effect"], first["target"]) == ("joint_backlash", "elbow")
