"""What MJCF has no words for acts in environments too, not in the replays of a diagnosis alone."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects import Domain
from idapt_pl.effects.acting import advance
from idapt_pl.effects.actuators import ActuatorDeadzone
from idapt_pl.effects.joints import JointCogging, JointDamping, JointFrictionloss, JointStribeck
from idapt_pl.effects.learned import LearnedForce
from idapt_pl.effects.world import ExternalForce

PENDULUM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody><body name="rod"><joint name="axis" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="1"/></body></worldbody>
  <actuator><motor name="axis" joint="axis"/></actuator>
</mujoco>"""


def domain(*effects):
    return Domain("d", lambda: mujoco.MjSpec.from_string(PENDULUM), tuple(effects))


def swing(world, steps=1500, start=1.0):
    """Angles of the rod, let go."""
    model = world.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = start
    angles = []
    for _ in range(steps):
        advance(model, data)
        angles.append(data.qpos[0])
    return np.array(angles)


def test_cogging_is_the_torque_that_its_formula_says():
    law = LearnedForce("axis", "a*sin(6*q) + b*cos(6*q)", a=0.4, b=-0.2)
    np.testing.assert_allclose(swing(domain(JointCogging("axis", 0.4, -0.2, 6.0))), swing(domain(law)), atol=1e-9)
    assert np.abs(swing(domain(law)) - swing(domain())).max() > 0.05


def test_stribeck_friction_of_one_level_is_dry_friction_and_falls_with_speed_else():
    dry = {level: swing(domain(JointFrictionloss("axis", level))) for level in (0.1, 0.3)}
    np.testing.assert_allclose(swing(domain(JointStribeck("axis", 0.3, 0.3, 0.1))), dry[0.3], atol=1e-9)
    falling = swing(domain(JointStribeck("axis", 0.1, 0.3, 0.1)))
    loss = {name: 1.0 + a.min() for name, a in {**dry, "falling": falling}.items()}  # of the first swing's height
    assert loss["falling"] == pytest.approx(loss[0.1], abs=0.01) and loss[0.3] > 2 * loss[0.1]  # it moves fast
    held, free = (swing(domain(JointStribeck("axis", 0.05, level, 0.1)), start=0.4) for level in (0.9, 0.05))
    assert held.min() > 0.35 and free.min() < -0.2  # MuJoCo's friction is soft: it creeps


def test_a_constant_force_can_carry_a_body():
    np.testing.assert_allclose(swing(domain(ExternalForce("rod", z=9.81)), start=0.7), 0.7, atol=1e-9)


def test_forces_that_others_apply_stay_as_they_are():
    model = domain(ExternalForce("rod", z=9.81), JointCogging("axis", 0.4)).compile()
    data = mujoco.MjData(model)
    data.qfrc_applied[0], data.xfrc_applied[1, 0] = 0.25, 0.5
    advance(model, data, 5)
    assert data.qfrc_applied[0] == 0.25 and data.xfrc_applied[1].tolist() == [0.5, 0, 0, 0, 0, 0]


def test_a_domain_knows_what_its_model_lacks():
    within, beyond = JointDamping("axis", 0.2), (JointStribeck("axis", 0.1, 0.3), ActuatorDeadzone("axis", 0.1))
    world = domain(beyond[0], within, beyond[1])
    assert world.beyond_mjcf == beyond and world.within_mjcf.effects == (within,)
    assert world.spec().joint("axis").frictionloss == 0.3 and world.within_mjcf.spec().joint("axis").frictionloss == 0
