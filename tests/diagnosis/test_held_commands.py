"""Commands averaged over time steps, through effects: means by fine sampling are the reference."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorBias, ActuatorRotation
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.held_commands import HeldCommands

XML = """<mujoco><worldbody><body><joint name="a"/><joint name="b" axis="1 0 0"/><joint name="c" axis="0 1 0"/>
<geom size="0.1"/></body></worldbody>
<actuator><motor name="a" joint="a"/><motor name="b" joint="b"/><motor name="c" joint="c"/></actuator></mujoco>"""
H, STEPS = 3e-3, 20


@pytest.fixture
def held():
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(XML)
    time = np.cumsum(rng.uniform(0.008, 0.012, 60))
    still, u = np.zeros((60, 3)), rng.normal(size=(60, 3))
    return HeldCommands(model, [Recording("one", time, still, still, u), Recording("two", time + 5, still, still, -u)])


WINDOWS = Windows(np.array([0, 0, 1]), np.array([10, 30, 20]), np.array([0, 3]))


def finely(held: HeldCommands, late: np.ndarray) -> np.ndarray:
    """Means of held commands that are late by some time each, by a thousand samples a step."""
    out = np.zeros((3, STEPS, 3))
    for n, (e, s) in enumerate(zip(WINDOWS.episode, WINDOWS.start, strict=True)):
        record = held.data[e]
        at = record.time[s] + H * (np.arange(STEPS * 1000) + 0.5) / 1000
        for i in range(3):
            k = np.clip(np.searchsorted(record.time, at - late[i], side="right") - 1, 0, None)
            out[n, :, i] = record.actions[k, i].reshape(STEPS, 1000).mean(1)
    return out


def test_commands_are_held_and_averaged(held):
    assert held.averaged((), WINDOWS, STEPS, H) == pytest.approx(finely(held, np.zeros(3)), abs=3e-3)


def test_an_effect_on_one_motor_leaves_the_others_commands(held):
    as_recorded = held.averaged((), WINDOWS, STEPS, H)
    late = held.averaged((ActuatorDelay("b", 0.013),), WINDOWS, STEPS, H)
    assert late == pytest.approx(finely(held, np.array([0, 0.013, 0])), abs=3e-3)
    np.testing.assert_array_equal(late[..., [0, 2]], as_recorded[..., [0, 2]])
    assert np.abs(late[..., 1] - as_recorded[..., 1]).max() > 0.1


def test_several_effects_act_one_after_the_other(held):
    turned_then_late = (ActuatorRotation("c a", 0.7), ActuatorDelay("a", 0.013), ActuatorBias("*", 0.3))
    u = held.averaged(turned_then_late, WINDOWS, STEPS, H)
    late = finely(held, np.full(3, 0.013))
    plain = finely(held, np.zeros(3))
    c = np.cos(0.7) * plain[..., 2] - np.sin(0.7) * plain[..., 0]
    a = np.sin(0.7) * late[..., 2] + np.cos(0.7) * late[..., 0]
    assert u == pytest.approx(np.stack([a, plain[..., 1], c], -1) + 0.3, abs=5e-3)


def test_what_was_asked_for_before_is_the_same_array(held):
    lag = (ActuatorLag("a", 0.01),)
    assert held.averaged(lag, WINDOWS, STEPS, H) is held.averaged(lag, WINDOWS, STEPS, H)
