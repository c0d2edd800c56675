"""Effects beside what a model has already: nothing of it is overwritten, and ``*`` reaches what an effect is of."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects.actuators import ActuatorGain, ActuatorKp, ActuatorKv, ActuatorSaturation
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.joints import JointArmature, JointBacklash, JointDamping
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag

XML = """<mujoco><option timestep="0.002"/><default><geom size="0.1" mass="1"/></default><worldbody>
<body><joint name="j"/><geom/></body><body pos="1 0 0"><joint name="k"/><geom/></body>
<body pos="2 0 0"><joint name="l"/><geom/></body></worldbody><actuator>{}</actuator></mujoco>"""
SERVOS = """<position name="a" joint="j" kp="9" kv="1"/><position name="b" joint="k" kp="9" kv="1"/>
<motor name="m" joint="l"/>"""


def spec(actuators):
    return mujoco.MjSpec.from_string(XML.format(actuators))


def patched(actuators, effect):
    repaired = repair_model(spec(actuators), (effect,), Path())
    return mujoco.MjModel.from_xml_string(repaired.patched), repaired.unsaid


def test_delays_and_lags_come_on_top_of_those_that_are_there():
    model, unsaid = patched('<motor name="m" joint="j" delay="0.02" nsample="11"/>', ActuatorDelay("m", 0.01))
    assert model.actuator_delay[0] == pytest.approx(0.03) and unsaid == ()
    lagged = '<general name="m" joint="j" dyntype="filterexact" dynprm="0.05"/>'
    model, unsaid = patched(lagged, ActuatorLag("m", 0.03))
    assert model.actuator_dynprm[0, 0] == pytest.approx(0.08) and unsaid == ()


def test_an_integrator_stays_one_and_the_lag_is_said_to_be_left_out():
    lag = ActuatorLag("m", 0.03)
    model, unsaid = patched('<intvelocity name="m" joint="j" kp="30" actrange="-3 3"/>', lag)
    assert model.actuator_dyntype[0] == mujoco.mjtDyn.mjDYN_INTEGRATOR and unsaid == (lag,)


@pytest.mark.parametrize(("own", "now"), [("0 1", [0, 0.5]), ("-2 0.2", [-0.5, 0.2]), (None, [-0.5, 0.5])])
def test_a_limit_narrows_a_range_and_widens_none(own, now):
    ranges = f'ctrlrange="{own}" forcerange="{own}"' if own else ""
    model, _ = patched(f'<motor name="m" joint="j" {ranges}/>', ActuatorSaturation("m", limit=0.5, force=0.5))
    assert model.actuator_ctrlrange[0].tolist() == now and model.actuator_forcerange[0].tolist() == now
    assert model.actuator_ctrllimited[0] and model.actuator_forcelimited[0]


def test_what_all_servos_get_the_motor_beside_them_does_not():
    model, _ = patched(SERVOS, ActuatorKp("*", 2.0))
    assert model.actuator_gainprm[:, 0].tolist() == [18, 18, 1]
    model, _ = patched(SERVOS, ActuatorKv("*", 3.0))
    assert model.actuator_biasprm[:, 2].tolist() == [-3, -3, 0]


def test_play_in_a_joint_is_no_joint_of_its_own():
    changed = spec(SERVOS)
    for effect in (JointBacklash("j", 0.1), JointDamping("*", 0.7), JointArmature("*", 0.05)):
        effect.apply(changed)
    model = changed.compile()
    at = model.jnt_dofadr[model.joint("j play").id]
    assert model.dof_damping[at] == model.dof_armature[at] == 0
    assert model.dof_damping[model.jnt_dofadr[model.joint("k").id]] == 0.7


def test_a_muscle_has_a_gain_of_its_force_and_no_candidates_of_a_motors():
    muscle = '<muscle name="m" joint="j" range="0.75 1.05" lengthrange="0.1 1" force="40"/>'
    model = spec(muscle).compile()
    typical = TypicalSizes(0.02, *[np.ones(3)] * 4, *[np.ones(1)] * 2, 0.1)
    of = {c.kind.name for c in all_candidates(spec(muscle), typical) if c.target == "m"}
    assert not of & {"actuator_gain", "actuator_kp", "actuator_kv"}
    weaker, _ = patched(muscle, ActuatorGain("m", 0.5))
    assert weaker.actuator_gainprm[0, 2] == 0.5 * model.actuator_gainprm[0, 2] == 20
    assert weaker.actuator_gainprm[0, 0] == model.actuator_gainprm[0, 0]
