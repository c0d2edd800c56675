"""Rows that are lost, exchanged or no measurements; drives and gravity of the model that are others: found, mended."""

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
from idapt_pl.deployment_faults.sequence import find_sequence_faults, without_sequence_faults
from idapt_pl.prediction.data import LEFT_OUT


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """The servo arm's model, and recordings of one with a heavier gripper."""
    nominal, measured = generate(CASES["servo_gripper_mass"], 0, tmp_path_factory.mktemp("servo"))
    return mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)


def with_rows(data, edit):
    """Recordings whose qpos, qvel and actions ``edit`` has made others of."""
    made = []
    for e in data:
        q, v, u = edit(*(np.array(x, float) for x in (e.observations["qpos"], e.observations["qvel"], e.actions)))
        made.append(Episode(u.astype(np.float32), {"qpos": q, "qvel": v}))
    return replace(data, episodes=tuple(made))


def lose(q, v, u):
    rows = np.arange(12, len(u) - 5, 20)
    return tuple(np.delete(x, rows, axis=0) for x in (q, v, u))


def exchange(q, v, u):
    for k in range(12, len(u) - 5, 20):
        for x in (q, v):
            x[[k, k + 1]] = x[[k + 1, k]]
    return q, v, u


def begin_with_zeros(q, v, u):
    q[:2], v[:2] = 0, 0
    return q, v, u


def test_nothing_is_found_in_rows_that_are_as_they_should_be(servo):
    spec, data = servo
    found = find_sequence_faults(spec.compile(), data)
    assert found.counts == (0, 0, 0) and without_sequence_faults(data, found).episodes == data.episodes


def begin_to_filter(q, v, u):
    """Velocities as a filter shows them that begins at nothing while the arm moves."""
    k = np.arange(len(v))[100:, None]
    return q[100:], v[100:] * (1 - 0.93 ** (k - 99)), u[100:]


def test_a_filter_that_has_just_begun_is_no_lost_rows(servo):
    spec, data = servo
    found = find_sequence_faults(spec.compile(), with_rows(data, begin_to_filter))
    assert found.counts[0] == 0


def test_lost_rows_get_their_time_back_and_are_left_out(servo):
    spec, data = servo
    faulty = with_rows(data, lose)
    found = find_sequence_faults(spec.compile(), faulty)
    missing = sum(map(len, data)) - sum(map(len, faulty))
    assert 0.8 * missing < found.counts[0] <= missing, "but for those lost at rest"
    assert found.counts[1:] == (0, 0)
    mended = without_sequence_faults(faulty, found)
    for e, o in zip(mended, data, strict=True):
        assert e.timestamps[-1] == pytest.approx(len(o) * data.dt, abs=4 * data.dt)
        assert e.infos[LEFT_OUT].sum() == (np.diff(e.timestamps) > 1.5 * data.dt).sum() > 0


def test_exchanged_rows_are_put_back(servo):
    spec, data = servo
    found = find_sequence_faults(spec.compile(), with_rows(data, exchange))
    assert found.counts[0] == found.counts[2] == 0
    assert found.swapped[0] == tuple(range(12, len(data.episodes[0]) - 5, 20))
    mended = without_sequence_faults(with_rows(data, exchange), found)
    np.testing.assert_array_equal(mended.episodes[0].observations["qpos"], data.episodes[0].observations["qpos"])


def test_first_rows_that_are_no_measurements_are_cut(servo):
    spec, data = servo
    faulty = with_rows(data, begin_with_zeros)
    found = find_sequence_faults(spec.compile(), faulty)
    assert found.counts == (0, 0, len(data)) and set(found.first) == {2}
    mended = without_sequence_faults(faulty, found)
    for e, o in zip(mended, data, strict=True):
        np.testing.assert_allclose(e.observations["qpos"], o.observations["qpos"][2:])
        np.testing.assert_allclose(e.actions, o.actions[2:])


def test_time_stamps_that_tell_of_lost_rows_are_no_fault(servo):
    spec, data = servo
    stamped = []
    for e in with_rows(data, lose):
        stamped.append(replace(e, timestamps=data.dt * np.arange(len(e) + 1.0)))
    assert find_sequence_faults(spec.compile(), replace(data, episodes=tuple(stamped))).counts == (0, 0, 0)


def test_servos_read_as_motors_are_found_and_the_model_gets_servos(servo):
    spec, data = servo
    motors = spec.copy()
    for a in motors.actuators:
        a.set_to_motor()
        a.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    report = find_deployment_faults(motors, data)
    assert [f.kind for f in report.faults] == [FaultKind.SERVO_AS_MOTOR], report.faults
    fixed, true = report.fixed_model(motors).compile(), spec.compile()
    np.testing.assert_allclose(fixed.actuator_biasprm[:, 1], true.actuator_biasprm[:, 1], rtol=0.4)
    assert "position servos" in report.faults[0].cure and report.fixed(data).dt == data.dt


@pytest.mark.parametrize("gravity", [(0, 9.81, 0), (0, 0, 9.81)])
def test_a_turned_base_is_found_and_gravity_put_right(servo, gravity):
    spec, data = servo
    turned = spec.copy()
    turned.option.gravity = gravity
    report = find_deployment_faults(turned, data)
    assert [f.kind for f in report.faults] == [FaultKind.GRAVITY_TURNED], report.faults
    np.testing.assert_allclose(report.fixed_model(turned).option.gravity, [0, 0, -9.81])
