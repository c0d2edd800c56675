"""A motor that turns with two joints: what it rubs and weighs is felt by both, and it is found."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis import diagnose
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects import Domain
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointDamping, JointFrictionloss
from idapt_pl.effects.wording import phrase_at, unit_at
from idapt_pl.effects.world import Numerics
from idapt_pl.report.diagnosis_wording import verdict_in_words

ARM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="upper"><joint name="elbow" axis="0 1 0"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3" mass="1"/>
    <body name="hand" pos="0 0 -0.3"><joint name="wrist" axis="0 1 0"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.2" mass="0.5"/></body></body></worldbody>
  <actuator><motor joint="elbow"/><motor joint="wrist"/></actuator>
</mujoco>"""
HIDDEN = SharedMotor("elbow wrist", damping=0.02, frictionloss=0.15, armature=0.004, ratio=1.0)


def arm(*effects):
    return Domain("arm", lambda: mujoco.MjSpec.from_string(ARM), effects).spec()


def forces_at(effect, velocity, acceleration):
    """What an effect asks of the two motors besides, in a given motion."""
    needed = []
    for spec in (arm(effect), arm()):
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qvel[:], data.qacc[:] = velocity, acceleration
        mujoco.mj_inverse(model, data)
        needed.append(data.qfrc_inverse.copy())
    return needed[0] - needed[1]


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.4])
def test_friction_and_rotor_act_on_both_joints_by_how_far_each_turns_the_motor(ratio):
    effect = SharedMotor("elbow wrist", damping=0.3, armature=0.05, ratio=ratio)
    velocity, acceleration = np.array([2.0, -0.5]), np.array([7.0, 3.0])
    at_motor = 0.3 * (velocity @ [ratio, 1.0]) + 0.05 * (acceleration @ [ratio, 1.0])
    np.testing.assert_allclose(forces_at(effect, velocity, acceleration), at_motor * np.array([ratio, 1.0]), rtol=1e-6)


def test_a_motor_that_both_joints_turn_against_each_other_does_not_rub():
    effect = SharedMotor("elbow wrist", damping=0.3, frictionloss=0.2)
    assert np.abs(forces_at(effect, [1.0, -1.0], [0.0, 0.0])).max() < 1e-9
    assert np.abs(forces_at(effect, [1.0, 1.0], [0.0, 0.0])).min() > 0.5


def test_names_with_spaces_are_taken_apart_and_units_are_those_of_the_joints():
    spec = mujoco.MjSpec.from_string(ARM.replace('"elbow"', '"left elbow"').replace('"wrist"', '"left wrist"'))
    SharedMotor("left elbow left wrist", frictionloss=0.1).apply(spec)
    model = spec.compile()
    assert model.ntendon == 1
    assert unit_at(model, "left elbow left wrist", "N·m or N") == "N·m"
    assert phrase_at("shared_motor", "elbow wrist") == "friction and rotor of a motor shared by joints elbow wrist"


@pytest.mark.parametrize("target", ["elbow", "elbow elbow", "wrist hand", "*"])
def test_a_target_that_is_not_two_joints_is_an_error(target):
    with pytest.raises(ValueError, match="two joints"):
        SharedMotor(target, frictionloss=0.1).apply(arm())


def test_it_is_tried_where_a_driven_joint_follows_another_of_its_kind():
    sizes = TypicalSizes(0.01, *(np.ones(2) for _ in range(6)), 0.2)
    found = [c for c in all_candidates(arm(), sizes) if c.kind is SharedMotor]
    assert [(c.target, c.size) for c in found] == [("elbow wrist", 3), ("elbow wrist", 3), ("elbow wrist", 4)]
    with_a_slide = mujoco.MjSpec.from_string(ARM.replace('name="wrist" axis', 'name="wrist" type="slide" axis'))
    assert not SharedMotor.candidates(with_a_slide.compile(), sizes)
    undriven = mujoco.MjSpec.from_string(ARM.replace('<motor joint="wrist"/>', ""))
    assert not SharedMotor.candidates(undriven.compile(), sizes)


def recorded(spec, episodes=6, steps=150, seed=0):
    """Both joints moved by smooth random torques; noise of 0.2 mrad, 2 mrad/s."""
    model, rng, made = spec.compile(), np.random.default_rng(seed), []
    for _ in range(episodes):
        data, rows = mujoco.MjData(model), []
        phase, pace = rng.uniform(0, 6, (2, 3)), rng.uniform(2, 12, (2, 3))
        for k in range(steps + 1):
            ctrl = 0.7 * np.sin(pace * k * 0.01 + phase).sum(1) * [1.0, 0.5]
            rows.append((data.qpos.copy(), data.qvel.copy(), ctrl))
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data, 5)
        q, v, u = (np.array(x) for x in zip(*rows, strict=True))
        q, v = q + rng.normal(0, 2e-4, q.shape), v + rng.normal(0, 2e-3, v.shape)
        made.append(Episode(u[:-1].astype(np.float32), {"qpos": q, "qvel": v}))
    return Trajectories(tuple(made), 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, -0.6])
def test_a_shared_motor_is_found_and_its_size_measured(ratio):
    hidden = replace(HIDDEN, ratio=ratio)
    diagnosis = diagnose(arm(), recorded(arm(hidden)), laws=False)
    (found,) = [e for e in diagnosis.effects if not isinstance(e, Numerics)]
    (told,) = verdict_in_words(diagnosis.result, diagnosis.sim.model)[:1]
    assert "shared by joints elbow wrist" in told and "ratio" in told
    assert isinstance(found, SharedMotor)
    for name in ("damping", "frictionloss", "armature", "ratio"):
        assert getattr(found, name) == pytest.approx(getattr(hidden, name), rel=0.02), name


@pytest.mark.slow
def test_nothing_shared_is_found_where_each_joint_has_its_own_friction():
    apart = arm(JointFrictionloss("elbow", 0.15), JointFrictionloss("wrist", 0.1), JointDamping("wrist", 0.05))
    result = diagnose(arm(), recorded(apart, seed=1), laws=False).result
    assert {e.key[0] for e in result.effects} == {"joint_frictionloss", "joint_damping"}
