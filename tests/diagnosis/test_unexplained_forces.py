"""Where sensors are nearly perfect, models are judged by forces: each joint's friction is found, and no huge rotor."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.unexplained_forces import beyond_noise, contradicts_forces, unexplained_forces
from idapt_pl.diagnosis.rounds.usual_causes import begin_with_usual_causes
from idapt_pl.diagnosis.search import by_forces_if_need_be, diagnose, forecasts_worse, search_by_forces
from idapt_pl.diagnosis.state.search_state import AcceptedEffect
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss, JointStiffness
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.force_windows import instants_of, judged_by_forces, judges_forces, lacking_forces
from idapt_pl.report.diagnosis_wording import verdict_in_words
from idapt_pl.report.minute_section import matter_in_words

ARM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body pos="0 0 1"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size="0.05"
fromto="0 0 0 0 0 -0.5" mass="4"/><body pos="0 0 -0.5"><joint name="elbow" axis="0 1 0"/><geom type="capsule"
size="0.03" fromto="0 0 0 0 0 -0.4" mass="1"/></body></body></worldbody>
<actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>"""
TRUE = (
    JointDamping("shoulder", 12.0), JointFrictionloss("shoulder", 8.0), JointDamping("elbow", 3.0),
    JointFrictionloss("elbow", 2.0),
)  # fmt: skip
DT, STEPS = 0.008, 500
QUICK = replace(DEFAULT_SETTINGS, thorough=False, max_effects=2)


def spec_of(effects=()):
    spec = mujoco.MjSpec.from_string(ARM)
    for e in effects:
        e.apply(spec)
    return spec


def recorded(effects=TRUE, ripple=0.5, noise=1e-8, episodes=4):
    """A slow motion under a controller; a torque by the other joint's angle and the time belongs to no effect."""
    rng, model, made = np.random.default_rng(0), spec_of(effects).compile(), []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        phase, rate = rng.uniform(0, 6.28, (2, 3)), rng.uniform(0.8, 3.5, (2, 3))
        wanted = lambda t, p=phase, r=rate: (0.35 * (np.sin(r * t + p) - np.sin(p))).sum(1)  # noqa: E731
        q, v, u = [data.qpos.copy()], [data.qvel.copy()], []
        for k in range(STEPS):
            t = (k + 1) * DT
            speed = (wanted(t) - wanted(t - DT)) / DT
            u.append(np.array([300.0, 80.0]) * (wanted(t) - data.qpos) + np.array([20.0, 5.0]) * (speed - data.qvel))
            data.ctrl[:] = u[-1]
            for _ in range(4):
                data.qfrc_applied[:] = ripple * np.array([4.0, 1.0]) * np.sin(5 * data.qpos[::-1] + 2 * data.time)
                mujoco.mj_step(model, data)
            q.append(data.qpos.copy())
            v.append(data.qvel.copy())
        q, v = (np.stack(x) + noise * rng.normal(size=(STEPS + 1, 2)) for x in (q, v))
        made.append(Episode(np.stack(u).astype(np.float32), {"qpos": q, "qvel": v}))
    return Trajectories(tuple(made), DT, "a simulated arm")


@pytest.fixture(scope="module")
def arm():
    return recorded()


def found(out):
    return {(e["effect"], e["target"]): e["parameters"] for e in out.report["effects"]}


def test_the_right_model_lacks_no_force_and_the_nominal_one_what_was_hidden():
    hidden = (JointDamping("shoulder", 12.0), JointArmature("elbow", 0.3))
    context, _ = begin_search(spec_of(), recorded(hidden, ripple=0.0), threads=1)
    instants = Windows(np.repeat([0, 2], 200), np.tile(np.arange(50, 250), 2), np.ones(1, int))
    right, nominal = (lacking_forces(context.sim, e, instants) for e in (hidden, ()))
    assert np.abs(right).max() < 0.02 * np.abs(nominal).max()
    speed = np.concatenate([context.sim.data[e].qvel[50:250] for e in (0, 2)])
    # damping brakes: what the model without it lacks points against the motion
    slope = np.polyfit(speed[:, 0], nominal[:, 0], 1)[0]
    assert slope == pytest.approx(-12.0, rel=0.02)


def test_forces_count_in_units_of_what_nothing_explains(arm):
    context, state = begin_search(spec_of(), arm, threads=1)
    split = judged_by_forces(state.windows.fit.windows, np.array([2.0, 0.5]))
    assert judges_forces(split) and not judges_forces(state.windows.fit)
    assert len(split.windows) == len(instants_of(state.windows.fit.windows))
    forces = lacking_forces(context.sim, TRUE, split.windows)
    np.testing.assert_allclose(split.residual(context.sim, TRUE), forces / [2.0, 0.5])
    part = split[np.arange(5)]
    np.testing.assert_allclose(part.residual(context.sim, TRUE), (forces / [2.0, 0.5])[:5])


def test_what_nothing_explains_is_far_less_than_what_is_missing(arm):
    context, state = begin_search(spec_of(), arm, threads=1)
    size = unexplained_forces(context, state)
    missing = np.sqrt(np.square(lacking_forces(context.sim, (), instants_of(state.windows.fit.windows))).mean(0))
    assert (size < 0.3 * missing).all() and (size > 0).all()


@pytest.mark.slow
def test_friction_and_damping_of_every_joint_are_found_and_no_rotor_inertia(arm):
    kinds = ["joint_damping", "joint_frictionloss", "joint_armature", "joint_drag", "body_mass"]
    out = diagnose(spec_of(), arm, threads=1, settings=QUICK, candidates=kinds)
    assert out.by_forces and judges_forces(out.state.windows.fit)
    what = found(out)
    for e in TRUE:
        (value,) = (p["estimate"] for p in what[e.name, e.target].values())
        (true,) = (v for k, v in e.to_dict()["parameters"].items() if k in what[e.name, e.target])
        assert value == pytest.approx(true, rel=0.25), e
    assert not any(name == "joint_armature" for name, _ in what)
    assert out.report["error"]["unexplained_force"].keys() == {"shoulder", "elbow"}
    assert out.report["error"]["after"] < 0.5 * out.report["error"]["before"]
    text = " ".join(verdict_in_words(out.result, out.sim.model))
    page = matter_in_words(out.result)
    assert all("the force that nothing explains" in x and "noise alone" not in x for x in (text, page))


def test_no_more_effects_than_were_asked_for_are_added_to_the_usual_causes():
    """Two springs are hidden beside the damping, and both would be found."""
    hidden = (JointDamping("shoulder", 12.0), JointStiffness("shoulder", 30.0), JointStiffness("elbow", 8.0))
    context, state = begin_search(
        spec_of(), recorded(hidden), threads=1, settings=replace(QUICK, max_effects=1),
        candidates=["joint_damping", "joint_stiffness"],
    )  # fmt: skip
    after, _ = search_by_forces(context, (state, ()))
    kinds = [c.kind for c in after.candidates]
    assert kinds.count(JointStiffness) == 1 and JointDamping in kinds


def test_a_motor_that_two_joints_share_is_among_the_usual_causes_where_there_is_one(arm):
    hidden = (*TRUE, SharedMotor("shoulder elbow", damping=2.0, frictionloss=3.0))
    shared = []
    for recording in (recorded(hidden), arm):
        context, state = begin_search(spec_of(), recording, threads=1, settings=QUICK)
        begun = begin_with_usual_causes(context, state)
        shared.append([e for e in begun.effects if isinstance(e, SharedMotor)])
        assert {JointFrictionloss, JointDamping} <= {type(e) for e in begun.effects}
    (found,), none = shared
    assert found.damping == pytest.approx(2.0, rel=0.3) and found.frictionloss == pytest.approx(3.0, rel=0.3)
    assert found.ratio == 1.0 and not none


def test_a_joint_that_never_moves_breaks_nothing(arm):
    one = np.float32([1, 0])
    held = [Episode(e.actions * one, {k: x * one for k, x in e.observations.items()}) for e in arm]
    context, state = begin_search(spec_of(), replace(arm, episodes=tuple(held)), threads=1, settings=QUICK)
    begun = begin_with_usual_causes(context, state)
    assert {c.target for c in begun.candidates} <= {"shoulder"}
    assert np.isfinite(context.loss(begun.windows.held_out, begun.effects)).all()
    for c in context.candidates:
        assert np.isfinite(context.whitened(begun.windows.scout, (c.effect(c.nominal),))).all()


def test_perfect_recordings_of_one_missing_effect_are_judged_by_noise():
    data = recorded((JointDamping("shoulder", 12.0),), ripple=0.0, noise=1e-7, episodes=3)
    out = diagnose(spec_of(), data, threads=1, settings=QUICK)
    assert list(found(out)) == [("joint_damping", "shoulder")]
    assert not judges_forces(out.state.windows.fit) and not beyond_noise(out.context, out.state)
    assert out.report["error"]["unexplained_force"] == {}


@pytest.fixture(scope="module")
def noisier():
    """A search of recordings in which forecasts are off by tens of standard deviations, not by thousands."""
    kinds = ["joint_damping", "joint_frictionloss", "joint_armature"]
    return begin_search(spec_of(), recorded(noise=5e-4), threads=1, settings=QUICK, candidates=kinds)


def naming(context, state, *effects):
    """A state in which these effects are accepted."""
    accepted = []
    for number, e in enumerate(effects):
        (candidate,) = (c for c in context.candidates if (c.kind, c.target) == (type(e), e.target))
        value = np.array([getattr(e, candidate.names[0])])
        accepted.append(AcceptedEffect(number, candidate, value))
    return replace(state, accepted=tuple(accepted))


def test_a_heavy_rotor_contradicts_the_forces_that_were_measured_and_friction_does_not(noisier):
    """Both leave much unexplained, and the rotor forecasts better than the model as it is."""
    context, state = noisier
    heavy, right = naming(context, state, JointArmature("*", 10.0)), naming(context, state, *TRUE)
    loss = {name: float(context.loss(s.windows.held_out, s.effects).mean()) for name, s in
            (("nominal", state), ("heavy", heavy), ("right", right))}  # fmt: skip
    assert 10 < loss["right"] < loss["heavy"] < loss["nominal"]
    assert contradicts_forces(context, heavy)
    assert not contradicts_forces(context, right) and not contradicts_forces(context, state)


def test_an_answer_that_contradicts_forces_gives_way_to_the_usual_causes(noisier):
    context, state = noisier
    heavy = naming(context, state, JointArmature("*", 10.0))

    def go_on(progress):
        raise AssertionError("forces explain it")

    after, _ = by_forces_if_need_be(context, (heavy, ()), go_on)
    assert judges_forces(after.windows.fit)
    assert {"joint_damping(shoulder)", "joint_frictionloss(shoulder)"} <= {c.label for c in after.candidates}
    rotors = [a.x[0] for a in after.accepted if a.candidate.kind is JointArmature]
    assert all(x < 1.0 for x in rotors)


def test_an_answer_by_forces_that_forecasts_worse_than_nothing_gives_way(monkeypatch):
    """As where friction that goes with the direction of motion is taken for a weight that is not there."""
    kinds = ["joint_damping", "joint_armature"]
    context, state = begin_search(
        spec_of(), recorded(noise=5e-4), declared=TRUE, threads=1, settings=QUICK, candidates=kinds
    )
    (nominal,) = (c.nominal[0] for c in context.candidates if c.label == "joint_armature(elbow)")
    absurd, harmless = (naming(context, state, JointArmature("elbow", x)) for x in (10.0, nominal))
    assert forecasts_worse(context, state, absurd) and not forecasts_worse(context, state, harmless)
    monkeypatch.setattr("idapt_pl.diagnosis.search.contradicts_forces", lambda *a: True)
    monkeypatch.setattr("idapt_pl.diagnosis.search.explains_forces", lambda *a: True)
    for found, kept in ((harmless, True), (absurd, False)):
        monkeypatch.setattr("idapt_pl.diagnosis.search.search_by_forces", lambda *a, found=found: (found, ()))
        after, _ = by_forces_if_need_be(context, (state, ()), lambda progress: progress)
        assert (after is found) == kept and (after is state) != kept
