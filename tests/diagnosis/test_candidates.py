"""What a diagnosis tries: scales from the recordings, and an order that does not depend on where classes stand."""

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.listing import (
    CANDIDATE_ORDER,
    all_candidates,
    in_order,
    numerics_candidates,
    typical_sizes,
)
from idapt_pl.effects import EFFECTS
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.prediction.data import Recording
from idapt_pl.tasks import make_task

CART = """
<mujoco>
  <option timestep="0.01" gravity="0 0 -10"/>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" mass="3" contype="0" conaffinity="0"/>
      <body name="pole"><joint name="hinge" axis="0 1 0" stiffness="1"/>
        <geom type="sphere" size="0.01" pos="0 0 -0.5" mass="2" contype="0" conaffinity="0"/></body></body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="1"/><position name="hold" joint="hinge" kp="5"/></actuator>
</mujoco>"""


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(CART)


@pytest.fixture
def typical():
    two = np.ones(2)
    return TypicalSizes(0.02, two, two, two, 2.0 * two, two, two, 0.2)


def test_typical_sizes_are_those_of_the_recordings(model):
    """Positions and velocities on a line, constant commands: every size is known."""
    time = np.arange(11) * 0.05
    qpos = np.stack([time, np.zeros(11)], 1)
    qvel = np.tile([2.0, -3.0], (11, 1))
    actions = np.tile([0.5, 0.1], (10, 1))
    sizes = typical_sizes(model, [Recording("one", time, qpos, qvel, actions)], 0.25)
    assert (sizes.dt, sizes.horizon) == (pytest.approx(0.05), 0.25)
    about_hinge = 2 * 0.5**2 + model.body("pole").inertia[1]
    np.testing.assert_allclose(sizes.inertia, [5.0, about_hinge])
    np.testing.assert_allclose(sizes.speed, [2.0, 3.0])
    np.testing.assert_allclose(sizes.range, [0.5, 0.0], atol=1e-8)
    np.testing.assert_allclose(sizes.motion, [time.std(), 0.0], atol=1e-8)
    np.testing.assert_allclose(sizes.command, [0.5, 0.1])
    np.testing.assert_allclose(sizes.force, [0.5, 5 * 0.1])
    np.testing.assert_allclose(sizes.torque, [5.0 * 2 / 0.25, about_hinge * 3 / 0.25])


def test_the_order_names_effects_that_there_are():
    names = {entry.partition("(")[0].partition(".")[0] for entry in CANDIDATE_ORDER.split()}
    assert names <= set(EFFECTS)


def test_effects_of_one_line_go_element_by_element(typical):
    labels = [c.label for c in all_candidates(mujoco.MjSpec.from_string(CART), typical)]
    start = labels.index("sensor_bias(slide)")
    assert labels[start : start + 8] == [
        "sensor_bias(slide)", "sensor_gain(slide)", "joint_stribeck(slide)", "joint_backlash(slide)",
        "sensor_bias(hinge)", "sensor_gain(hinge)", "joint_stribeck(hinge)", "joint_backlash(hinge)",
    ]  # fmt: skip
    assert labels[:3] == ["joint_damping(slide)", "joint_damping(hinge)", "joint_damping(*)"]
    assert labels[-3:] == ["gravity_direction(world)"] * 3


def test_the_order_does_not_depend_on_where_classes_stand(model, typical):
    by_class = [kind.candidates(model, typical) for kind in EFFECTS.values()]
    forth = in_order([c for offered in by_class for c in offered])
    back = in_order([c for offered in reversed(by_class) for c in offered])
    assert forth == back


def test_other_numerics_are_tried_from_the_coarsest_to_the_finest(model):
    tried = numerics_candidates(model)
    assert [(n.timestep, n.integrator) for n in tried] == [
        (0.01, "implicitfast"),
        (0.01, "RK4"),
        (0.002, "implicitfast"),
    ]


def test_the_models_own_numerics_are_no_others(model):
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert [(n.timestep, n.integrator) for n in numerics_candidates(model)] == [(0.01, "RK4"), (0.002, "implicitfast")]


JOINT_EFFECTS = ("joint_damping", "joint_frictionloss", "joint_armature", "joint_stiffness", "joint_drag",
                 "joint_stribeck", "joint_cogging", "sensor_bias", "sensor_gain")  # fmt: skip


@pytest.mark.parametrize("name", ["half_cheetah", "walker2d"])
def test_coordinates_of_a_floating_base_are_no_machine_parts(name):
    """A walker's torso has no rotor inertia, friction or encoder by which it moves in the world."""
    model = make_task(name).domain("source").compile()
    ones = np.ones(model.nv)
    typical = TypicalSizes(0.05, ones, ones, ones, 20 * ones, np.ones(model.nu), np.ones(model.nu), 0.5)
    for effect in JOINT_EFFECTS:
        targets = {c.target for c in EFFECTS[effect].candidates(model, typical)}
        assert targets and not targets & {"rootx", "rootz", "rooty", "*"}, effect
    assert "actuated" in {c.target for c in EFFECTS["joint_armature"].candidates(model, typical)}


NESTED = """
<mujoco><worldbody>
  <body name="x"><joint name="rootx" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="1e-3" diaginertia="1 1 1"/>
    <body name="z"><joint name="rootz" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1 1 1"/>
      <body name="trunk"><joint name="pitch" axis="0 1 0"/><geom size="0.1" mass="3"/>
        <body name="leg"><joint name="hip" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.4" mass="1"/></body>
      </body></body></body>
</worldbody><actuator><motor name="hip" joint="hip"/></actuator></mujoco>"""
ACROBOT = """
<mujoco><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.4" mass="1"/>
    <body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0"/>
      <geom size="0.05" pos="0 0 -0.4" mass="1"/></body>
  </body>
</worldbody>{actuator}</mujoco>"""


def joints_tried(xml, effect):
    model = mujoco.MjModel.from_xml_string(xml)
    ones, commands = np.ones(model.nv), np.ones(model.nu)
    typical = TypicalSizes(0.02, ones, ones, ones, 20 * ones, commands, commands, 0.2)
    return {c.target for c in EFFECTS[effect].candidates(model, typical)}


@pytest.mark.parametrize("effect", JOINT_EFFECTS)
def test_coordinates_of_a_base_that_is_several_bodies_are_no_machine_parts(effect):
    assert not joints_tried(NESTED, effect) & {"rootx", "rootz", "pitch", "*"}
    assert "hip" in joints_tried(NESTED, effect)


def test_a_bearing_at_the_root_has_friction_but_no_rotor_and_no_magnets():
    driven = ACROBOT.format(actuator='<actuator><motor name="elbow" joint="elbow"/></actuator>')
    for effect in ("joint_damping", "joint_frictionloss", "sensor_bias"):
        assert {"shoulder", "elbow"} <= joints_tried(driven, effect), effect
    for effect in ("joint_armature", "joint_cogging", "joint_backlash"):
        assert joints_tried(driven, effect) == {"elbow"}, effect


def test_without_any_actuator_motors_may_be_switched_off():
    assert {"shoulder", "elbow"} <= joints_tried(ACROBOT.format(actuator=""), "joint_armature")


def test_a_passive_joint_of_a_mechanism_is_a_machine_part():
    model = make_task("inverted_pendulum").domain("source").compile()
    ones = np.ones(model.nv)
    typical = TypicalSizes(0.05, ones, ones, ones, 20 * ones, np.ones(model.nu), np.ones(model.nu), 0.5)
    assert {"slider", "hinge"} <= {c.target for c in EFFECTS["joint_damping"].candidates(model, typical)}


def test_a_marker_without_weight_is_no_part_of_the_machine(typical):
    marked = CART.replace(
        '<geom type="sphere"',
        '<body name="goal"><geom size="0.01" mass="1e-9" contype="0" conaffinity="0"/></body><geom type="sphere"',
    )
    model = mujoco.MjSpec.from_string(marked)
    targets = {c.target for c in all_candidates(model, typical)}
    assert "pole" in targets and "goal" not in targets
    tried = [c for c in all_candidates(model, typical) if c.starts]
    for c in tried:  # an effect at its nominal value is within its bounds
        c.effect(c.nominal)
