"""Limits come from the model, options narrow them, and what cannot be is said in a sentence."""

import mujoco
import numpy as np
import pytest
from arms import RAIL, compiled

from idapt_pl.effects.end_stops import JointRange
from idapt_pl.excitation.limits import TURN, ImpossibleMotion, joint_ranges, limits_of, servo_dof
from idapt_pl.excitation.safety import limit_margins, motion_excess, relative_size


def test_limits_are_those_of_the_model_less_the_margin():
    limits = limits_of(compiled(), margin=0.1)
    assert limits.position[0] == pytest.approx([-1.6, 1.6])
    assert limits.command[0] == pytest.approx([-1.2, 1.2])  # ctrlrange, which is narrower than the joint's
    assert np.isinf(limits.velocity).all() and np.isinf(limits.force).all()


def test_options_narrow_and_never_widen():
    limits = limits_of(
        compiled(), {"*": (-9.0, 0.5)}, {"shoulder": (0, 2.0)}, {"servo": (-0.3, 9.0)}, {"*": (0, 1.0)}, margin=0
    )
    assert limits.position[0] == pytest.approx([-2.0, 0.5]) and limits.velocity[0] == 2.0
    assert limits.command[0] == pytest.approx([-0.3, 1.5]) and limits.force[0] == pytest.approx([-1.0, 1.0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"position": {"elbow": (0, 1)}}, "the model has no 'elbow'; it has: shoulder"),
        ({"command": {"servo": (2.0, 3.0)}}, "nothing is left for servo"),
        ({"velocity": {"servo": (0, 1)}}, "it has: shoulder"),
    ],
)
def test_limits_that_cannot_be_are_named(options, said):
    with pytest.raises(ImpossibleMotion, match=said):
        limits_of(compiled(), **options)


def test_a_motor_without_a_range_needs_one():
    with pytest.raises(
        ImpossibleMotion,
        match=r"no ctrlrange in the model: push\. Give lowest and highest commands, --command push=LOW:HIGH",
    ):
        limits_of(compiled(RAIL.replace('ctrlrange="-1 1" ctrllimited="true"', "")))
    with pytest.raises(ImpossibleMotion, match="no actuators"):
        limits_of(compiled(RAIL[: RAIL.index("<actuator>")] + "</mujoco>"))


def test_a_motor_without_a_range_has_what_its_joint_bears():
    bears = RAIL.replace(' ctrlrange="-1 1" ctrllimited="true"', "")
    bears = bears.replace(
        '<joint name="rail"', '<joint name="rail" actuatorfrcrange="-20 30" actuatorfrclimited="true"'
    )
    assert limits_of(compiled(bears), margin=0.1).command[0].tolist() == pytest.approx(
        [-1.5, 2.5]
    )  # of -2 to 3: gear 10


def test_only_servos_command_positions():
    assert servo_dof(compiled(), 0) == 0 and servo_dof(compiled(RAIL), 0) is None


def test_limits_as_json_have_names_and_no_infinity():
    entry = limits_of(compiled(), velocity={"*": (0, 3.0)}).to_dict(compiled())
    assert entry["velocity"] == {"shoulder": 3.0} and entry["force"] == {} and entry["no_contact"]


def test_a_motion_is_measured_against_its_limits():
    model, limits = compiled(), limits_of(compiled(), {"*": (-1.0, 0.5)}, {"*": (0, 2.0)})
    qpos, qvel = np.array([[[0.0], [0.25], [-0.9]]]), np.array([[[0.0], [1.0], [-2.2]]])
    assert motion_excess(model, limits, qpos, qvel)[0] == pytest.approx(0.2 / 4.0)
    assert relative_size(model, limits, qpos, qvel)[0] == pytest.approx(1.1)
    room = {m.what: m.room for m in limit_margins(model, limits, qpos[0], qvel[0])}
    assert room == pytest.approx({"position shoulder": 0.1 / 1.5, "velocity shoulder": -0.05})
    assert motion_excess(model, limits, np.full((1, 2, 1), np.nan), np.zeros((1, 2, 1)))[0] > 0


def test_an_end_that_is_open_takes_no_room_from_the_other():
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="1"/></body></worldbody></mujoco>'
    )
    JointRange("j", upper=0.5).apply(spec)
    assert joint_ranges(spec.compile(), 0.05)[0, 1] == pytest.approx(0.5 - 0.05 * TURN)
