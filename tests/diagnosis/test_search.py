"""What was planted is found, nothing where nothing is, and what no effect explains is called that."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import ARM, DT, NOISE_Q, NOISE_V, found, record

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import SensorGain
from idapt_pl.prediction.data import UnusableData
from idapt_pl.prediction.noise import Noise


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


@pytest.mark.parametrize("ratio", [0.05, 0.3, 6.0, 40.0])
def test_a_mass_far_from_nominal_is_found_whichever_way_it_is_off(ratio):
    """Beyond the ratios that fits start from too."""
    others = ["joint_armature", "joint_damping", "joint_frictionloss", "actuator_gain", "actuator_delay"]
    data = record(ARM.replace('mass="0.4"', f'mass="{0.4 * ratio}"'))
    diagnosis, effects = found(data, candidates=["body_mass", *others])
    assert (diagnosis.verdict, set(effects)) == ("effects_found", {("body_mass", "lower")})
    mass = effects["body_mass", "lower"]["parameters"]["mass"]
    assert mass["estimate"] == pytest.approx(0.4 * ratio, rel=0.05)


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
