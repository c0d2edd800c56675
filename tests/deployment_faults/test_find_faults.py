"""Planted deployment faults are found again and taken out; nothing is found where nothing is planted."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from datamodules import Episode, read_trajectories

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed

from benchmarks.undeclared.cases import CASES
from benchmarks.undeclared.generate import generate
from idapt_pl.deployment_faults import FaultKind, find_deployment_faults
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.prediction.data import UnusableData

DEGREES = 180 / np.pi


def recorded(case, folder):
    """A nominal model and recordings."""
    nominal, measured = generate(CASES[case], 0, folder)
    return mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """The servo arm's model, and recordings of one with a heavier gripper."""
    return recorded("servo_gripper_mass", tmp_path_factory.mktemp("servo"))


def edited(data, edit, dt=1.0):
    """Recordings in which ``edit(qpos, qvel, actions)`` has changed each episode in place."""
    made = []
    for e in data:
        q, v, u = (np.array(x, float) for x in (e.observations["qpos"], e.observations["qvel"], e.actions))
        edit(q, v, u)
        made.append(Episode(u.astype(np.float32), {"qpos": q, "qvel": v}))
    return replace(data, episodes=tuple(made), dt=data.dt * dt)


def turn_elbow(q, v, u):
    q[:, 2] *= -1
    v[:, 2] *= -1


def joints_in_degrees(q, v, u):
    q *= DEGREES
    v *= DEGREES


def elbow_in_degrees(q, v, u):
    q[:, 2] *= DEGREES
    v[:, 2] *= DEGREES


def joints_in_counts(q, v, u):
    q *= 16384 / (2 * np.pi)
    v *= 16384 / (2 * np.pi)


def swap_joints(q, v, u):
    q[:] = q[:, [0, 2, 1]].copy()
    v[:] = v[:, [0, 2, 1]].copy()


def velocities_in_degrees(q, v, u):
    v *= DEGREES


def turn_velocity(q, v, u):
    v[:, 1] *= -1


def swap_velocities(q, v, u):
    v[:] = v[:, [1, 0, 2]].copy()


def late_notes(q, v, u):
    u[2:] = u[:-2].copy()


def late_note_of_elbow(q, v, u):
    u[2:, 2] = u[:-2, 2].copy()


def commands_in_degrees(q, v, u):
    u *= DEGREES


def turn_command(q, v, u):
    u[:, 1] *= -1


def swap_commands(q, v, u):
    u[:] = u[:, ::-1].copy()


def nothing(q, v, u):
    pass


PLANTED = [
    (turn_elbow, 1.0, FaultKind.JOINT_SIGN, ("elbow",), -1.0),
    (joints_in_degrees, 1.0, FaultKind.JOINT_UNIT, ("yaw", "shoulder", "elbow"), 1 / DEGREES),
    (elbow_in_degrees, 1.0, FaultKind.JOINT_UNIT, ("elbow",), 1 / DEGREES),
    (joints_in_counts, 1.0, FaultKind.JOINT_UNIT, ("yaw", "shoulder", "elbow"), round(2 * np.pi / 16384, 9)),
    (swap_joints, 1.0, FaultKind.JOINT_ORDER, ("shoulder", "elbow"), ("elbow", "shoulder")),
    (velocities_in_degrees, 1.0, FaultKind.VELOCITY_UNIT, ("yaw", "shoulder", "elbow"), 1 / DEGREES),
    (turn_velocity, 1.0, FaultKind.VELOCITY_SIGN, ("shoulder",), -1.0),
    (swap_velocities, 1.0, FaultKind.VELOCITY_ORDER, ("yaw", "shoulder"), ("shoulder", "yaw")),
    (late_notes, 1.0, FaultKind.COMMAND_CLOCK, ("*",), -0.04),
    (late_note_of_elbow, 1.0, FaultKind.COMMAND_CLOCK, ("elbow",), -0.04),
    (commands_in_degrees, 1.0, FaultKind.COMMAND_UNIT, ("yaw", "shoulder", "elbow"), 1 / DEGREES),
    (turn_command, 1.0, FaultKind.COMMAND_SIGN, ("shoulder",), -1.0),
    (swap_commands, 1.0, FaultKind.COMMAND_ORDER, ("yaw", "elbow"), ("elbow", "yaw")),
    (nothing, 2.0, FaultKind.CONTROL_PERIOD, ("*",), 0.5),
]


@pytest.mark.parametrize(
    ("edit", "dt", "kind", "targets", "estimate"), PLANTED, ids=lambda x: getattr(x, "__name__", "")
)
def test_a_planted_fault_is_found_alone_and_taken_out(servo, edit, dt, kind, targets, estimate):
    model, data = servo
    faulty = edited(data, edit, dt)
    report = find_deployment_faults(model, faulty)
    (fault,) = report.faults
    assert (fault.kind, fault.targets) == (kind, targets)
    assert fault.estimate == (estimate if isinstance(estimate, tuple) else pytest.approx(estimate, rel=1e-6))
    assert fault.cure and fault.words
    fixed = report.fixed(faulty)
    first, lost = report.mend.margins
    assert fixed.dt == pytest.approx(data.dt)
    for e, o in zip(fixed, data, strict=True):
        last = len(o) - lost
        np.testing.assert_allclose(e.actions, o.actions[first:last], atol=1e-5)
        np.testing.assert_allclose(e.observations["qpos"], o.observations["qpos"][first : last + 1], atol=1e-9)
        np.testing.assert_allclose(e.observations["qvel"], o.observations["qvel"][first : last + 1], atol=1e-9)


@pytest.mark.parametrize("gear", [50.0, 1 / 20])
def test_a_factor_of_no_unit_is_found_in_commands(gear, tmp_path):
    """As of torques in front of a gear; the pendulum has friction that the model lacks."""
    model, data = recorded("pendulum_frictionloss", tmp_path)

    def in_front(q, v, u):
        u /= gear

    (fault,) = find_deployment_faults(model, edited(data, in_front)).faults
    assert fault.kind is FaultKind.COMMAND_UNIT and fault.estimate == pytest.approx(gear, rel=0.1)


def test_a_gain_of_a_motor_is_no_unit(tmp_path):
    model, data = recorded("pendulum_frictionloss", tmp_path)

    def weaker(q, v, u):
        u *= 3

    assert not find_deployment_faults(model, edited(data, weaker)).faults


@pytest.mark.parametrize("case", ["control_servo_fine", "servo_gripper_mass", "cheetah_delay", "control_servo_quiet"])
def test_nothing_is_found_where_nothing_is_planted(case, tmp_path):
    model, data = recorded(case, tmp_path)
    report = find_deployment_faults(model, data)
    assert report.faults == () and report.fixed(data) is data
    assert report.to_dict(False)["faults"] == []


def test_a_joint_zero_is_measured(servo):
    model, data = servo

    def edit(q, v, u):
        q[:, 2] += 0.6

    (fault,) = find_deployment_faults(model, edited(data, edit)).faults
    assert (fault.kind, fault.targets, fault.unit) == (FaultKind.JOINT_ZERO, ("elbow",), "rad")
    assert fault.estimate == pytest.approx(-0.6, abs=0.05) and fault.ci95[0] <= fault.estimate <= fault.ci95[1]


def test_repeated_samples_are_interpolated(servo):
    model, data = servo

    def edit(q, v, u):
        for x in (q, v):
            x[5:-1:8] = x[4:-2:8].copy()

    faulty = edited(data, edit)
    report = find_deployment_faults(model, faulty)
    assert [f.kind for f in report.faults] == [FaultKind.REPEATED_SAMPLES]
    off = [
        [np.abs(e.observations["qpos"] - o.observations["qpos"]).mean() for e, o in zip(d, data, strict=True)]
        for d in (faulty, report.fixed(faulty))
    ]
    assert np.sum(off[1]) < 0.5 * np.sum(off[0])


def test_a_mechanism_at_rest_read_in_coarse_steps_repeats_nothing(servo):
    model, data = servo
    still = edited(data, lambda q, v, u: (q.__imul__(0), v.__imul__(0)))
    assert find_deployment_faults(model, still).faults == ()


def test_two_faults_are_both_found(servo):
    model, data = servo

    def edit(q, v, u):
        turn_elbow(q, v, u)
        late_notes(q, v, u)

    found = {f.kind for f in find_deployment_faults(model, edited(data, edit)).faults}
    assert found == {FaultKind.JOINT_SIGN, FaultKind.COMMAND_CLOCK}


def test_bad_recordings_are_told_as_the_diagnosis_tells_them(servo):
    model, data = servo
    with pytest.raises(UnusableData, match="qpos"):
        find_deployment_faults(model, replace(data, episodes=(Episode(data.episodes[0].actions, {}),)))


def test_short_recordings_are_left_alone(servo):
    model, data = servo
    e = data.episodes[0]
    short = Episode(e.actions[:8], {k: x[:9] for k, x in e.observations.items()})
    assert find_deployment_faults(model, replace(data, episodes=(short,))).faults == ()


def test_a_shift_leaves_something_of_an_episode(servo):
    model, data = servo
    compiled = model.copy().compile()
    e = data.episodes[0]
    short = Episode(e.actions[:6], {k: x[:7] for k, x in e.observations.items()})
    mend = Mend.nothing(compiled).delayed_commands((4, 4, 4))
    with pytest.raises(ValueError, match="episode_0: 6 steps are too few"):
        mend.apply(compiled, replace(data, episodes=(short,)))
