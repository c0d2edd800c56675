"""A joint's damping and what its servo feeds back of velocities are one force, and are told as such."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.answer.summary import inseparable
from idapt_pl.effects.actuators import ActuatorKv
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping

SERVO = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody><body><joint name="hip" axis="0 1 0" damping="0.2"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="1"/></body></worldbody>
  <actuator><position name="hold" joint="hip" kp="8" kv="0.5" gear="2"/></actuator>
</mujoco>"""
KV = Candidate(ActuatorKv, "hold", ("kv",), (0.5,), (0.5,))
DAMPING = Candidate(JointDamping, "hip", ("damping",), (0.2,), (0.5,))


def accepted(candidate, value):
    return SimpleNamespace(candidate=candidate, x=np.array([value]), equivalent=())


def swing(effect):
    """Where the joint goes, with an effect."""
    spec = mujoco.MjSpec.from_string(SERVO)
    effect.apply(spec)
    model = spec.compile()
    data, places = mujoco.MjData(model), []
    data.ctrl[0] = 1.0
    for _ in range(100):
        mujoco.mj_step(model, data)
        places.append(data.qpos[0])
    return np.array(places)


@pytest.mark.parametrize(("candidate", "value"), [(KV, 0.8), (KV, 0.48), (DAMPING, 1.4), (DAMPING, 0.0)])
def test_one_force_has_two_names(candidate, value):
    model = mujoco.MjModel.from_xml_string(SERVO)
    (twin,) = inseparable(model, accepted(candidate, value))
    other = twin.other
    kind = {"actuator_kv": ActuatorKv, "joint_damping": JointDamping}[other.effect]
    itself, same = swing(candidate.effect([value])), swing(kind(other.target, *other.parameters.values()))
    np.testing.assert_allclose(same, itself, atol=1e-9)
    own = {ActuatorKv: 0.5, JointDamping: 0.2}[kind]
    by = (other.parameters[next(iter(other.parameters))] - own) / (value - candidate.nominal[0])
    assert twin.nominal == own and twin.scale == pytest.approx(by * candidate.scale[0])
    assert kind is not candidate.kind and np.abs(itself - swing(JointDamping("hip", 0.2))).max() > 1e-3


@pytest.mark.parametrize(
    ("value", "change"),
    [
        (0.3, ("", "")),  # a damping below 0 would have to make up for it
        (0.8, ('integrator="implicitfast"', "")),
        (0.8, ('kv="0.5"', 'kv="0.5" forcelimited="true" forcerange="-1 1"')),
        (0.8, ('damping="0.2"', 'damping="0.2" actuatorfrclimited="true" actuatorfrcrange="-1 1"')),
    ],
)
def test_nothing_else_is_told_where_they_are_not_one(value, change):
    model = mujoco.MjModel.from_xml_string(SERVO.replace(*change) if change[0] else SERVO)
    assert inseparable(model, accepted(KV, value)) == []


def test_a_joint_without_damping_of_its_own_has_the_other_name_too():
    """Nothing is divided by a nominal value that is 0."""
    model = mujoco.MjModel.from_xml_string(SERVO.replace('damping="0.2"', ""))
    undamped = Candidate(JointDamping, "hip", ("damping",), (0.0,), (0.5,))
    (twin,) = inseparable(model, accepted(undamped, 0.8))
    assert twin.other.parameters == {"kv": 0.7} and (twin.nominal, twin.scale) == (0.5, 0.125)


def test_what_was_found_to_be_as_good_is_told_once():
    model, found = mujoco.MjModel.from_xml_string(SERVO), accepted(KV, 0.8)
    found.equivalent = (SimpleNamespace(candidate=DAMPING),)
    assert inseparable(model, found) == []
