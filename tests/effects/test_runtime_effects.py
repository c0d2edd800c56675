"""Effects on commands, forces and measurements: each law on signals whose answer is known."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.actuators import (
    ActuatorBias,
    ActuatorCurve,
    ActuatorDeadzone,
    ActuatorRotation,
    ActuatorSaturation,
)
from idapt_pl.effects.joints import JointCogging, JointStribeck
from idapt_pl.effects.runtime import Command
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag, SensorBias, SensorDelay, SensorGain

STEP = Command(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 5.0], [2.0, 6.0]]))  # two actuators, held for 1 s each


def at(command, times, column=0):
    """Value of a command at some times."""
    k = np.searchsorted(command.edges, times, side="right") - 1
    return command.values[np.clip(k, 0, len(command.values) - 1), column]


@pytest.mark.parametrize(
    ("effect", "before", "after"),
    [
        (ActuatorBias("a", 0.3), 1.0, 1.3),
        (ActuatorDeadzone("a", 0.3), 1.0, 0.7),
        (ActuatorDeadzone("a", 0.3), -1.0, -0.7),
        (ActuatorDeadzone("a", 0.3), 0.2, 0.0),
        (ActuatorSaturation("a", 0.5), -1.0, -0.5),
        (ActuatorCurve("a", 1.0, full=2.0), -1.0, -0.5),
        (ActuatorCurve("a", 0.4, full=2.0), 1.0, 0.8),
        (ActuatorCurve("a", 0.4, full=2.0), 2.0, 2.0),
    ],
)
def test_memoryless_laws(effect, before, after):
    command = effect.transform(Command(np.array([0.0, 1.0]), np.array([[before, before]])), [0], 0.01)
    assert command.values[0].tolist() == pytest.approx([after, before]), "only the actuators meant are changed"


def test_delay_shifts_one_column_and_leaves_the_other():
    late = ActuatorDelay("a", 0.25).transform(STEP, [0], 0.01)
    assert at(late, np.array([0.1, 1.2, 1.3])).tolist() == [0.0, 0.0, 2.0]
    assert at(late, np.array([0.1, 1.2, 1.3]), 1).tolist() == [5.0, 6.0, 6.0]


def test_late_measurements_are_late_commands_of_all_actuators():
    late = SensorDelay("*", 0.25).transform(STEP, [], 0.01)
    assert at(late, np.array([1.2, 1.3]), 0).tolist() == [0.0, 2.0]
    assert at(late, np.array([1.2, 1.3]), 1).tolist() == [5.0, 6.0]


def test_rotation_keeps_the_length_of_two_commands_and_a_quarter_turn_crosses_them():
    turned = ActuatorRotation("a b", 0.3).transform(STEP, [0, 1], 0.01)
    np.testing.assert_allclose(np.linalg.norm(turned.values, axis=1), np.linalg.norm(STEP.values, axis=1))
    crossed = ActuatorRotation("a b", np.pi / 2).transform(STEP, [0, 1], 0.01).values
    np.testing.assert_allclose(crossed, np.stack([-STEP.values[:, 1], STEP.values[:, 0]], 1), atol=1e-12)


def test_lag_follows_the_exponential():
    tau, h = 0.2, 0.001
    slow = ActuatorLag("a", tau).transform(STEP, [0], h)
    t = np.array([1.1, 1.3, 1.8])
    np.testing.assert_allclose(at(slow, t), 2.0 * (1 - np.exp(-(t - 1.0 + h / 2) / tau)), atol=2e-3)


def test_native_delay_and_lag_do_the_same_as_the_paths():
    """What ``patched.xml`` does with a command and what the diagnosis fitted are one thing."""
    xml = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint name="j" type="slide"/>
      <geom size="0.1" mass="1"/></body></worldbody><actuator><motor name="m" joint="j"/></actuator></mujoco>"""
    commands = Command(np.arange(6) * 0.02, np.array([[0.0], [1.0], [-0.5], [2.0], [0.0]]))
    for effect in (ActuatorDelay("m", 0.013), ActuatorLag("m", 0.015)):
        arrived = effect.transform(commands, [0], 0.001)
        native, by_path = [], []
        for apply in (True, False):
            spec = mujoco.MjSpec.from_string(xml)
            if apply:
                effect.apply(spec)
            model = spec.compile()
            data = mujoco.MjData(model)
            for k in range(100):
                data.ctrl[:] = at(commands if apply else arrived, np.array([k * 0.001 + 1e-6]))
                mujoco.mj_step(model, data)
            (native if apply else by_path).append(data.qvel[0])
        assert native == pytest.approx(by_path, abs=0.02 * np.abs(commands.values).max() * 0.1)


def test_sensing_inverts():
    q, v = np.array([0.3, -0.2]), np.array([1.0, 2.0])
    for effect in (SensorBias("j", 0.1), SensorGain("j", 1.2)):
        seen = effect.measure(q, v)
        assert not np.allclose(seen[0], q)
        for back, true in zip(effect.invert(*seen), (q, v), strict=True):
            np.testing.assert_allclose(back, true)


def test_stribeck_friction_opposes_motion_and_falls_with_speed():
    law = JointStribeck("j", coulomb=1.0, static=2.0, speed=0.1)
    v = np.array([[-1.0], [0.05], [1.0]])
    dry = -law.static * np.sign(v[:, 0])  # the constraint's share
    torque = dry + law.force(v, v, np.zeros(3))[:, 0]
    assert np.sign(torque).tolist() == [1.0, -1.0, -1.0]
    assert abs(torque[1]) > abs(torque[2]) == pytest.approx(1.0)


def test_cogging_repeats_with_the_angle():
    law = JointCogging("j", sine=0.3, cosine=0.1, periods=6)
    q = np.linspace(0, 1, 7)[:, None]
    np.testing.assert_allclose(law.force(q, q, q[:, 0]), law.force(q + 2 * np.pi / 6, q, q[:, 0]), atol=1e-12)
