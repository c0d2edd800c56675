"""Commands averaged over time steps, through effects: means by fine sampling are the reference."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorBias, ActuatorDeadzone, ActuatorRotation, ActuatorSaturation
from idapt_pl.effects.domain import Domain
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


@pytest.mark.parametrize("bend", [ActuatorSaturation("a", 0.4), ActuatorDeadzone("a", 0.5)], ids=lambda e: e.name)
@pytest.mark.parametrize("lag_first", [True, False])
def test_limits_and_dead_zones_act_before_lags_as_in_the_repaired_model(bend, lag_first):
    steps, period, h = 720, 60, 5e-4
    commands = np.random.default_rng(1).normal(size=(steps // period, 3)).repeat(period, 0)
    time, still = h * np.arange(steps + 1), np.zeros((steps + 1, 3))
    effects = (ActuatorLag("a", 0.02), bend) if lag_first else (bend, ActuatorLag("a", 0.02))
    domain = Domain("repaired", lambda: mujoco.MjSpec.from_string(XML), effects)
    model = domain.compile()
    model.opt.timestep = h
    data, forces = mujoco.MjData(model), []
    for u in domain.command(model, commands):
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        forces.append(data.actuator_force[0])
    held = HeldCommands(mujoco.MjModel.from_xml_string(XML), [Recording("one", time, still, still, commands)])
    begin = 4 * period  # what was in the filter before the first command is not known
    window = Windows(np.zeros(1, int), np.array([begin]), np.array([0, steps - begin]))
    foretold = held.averaged(effects, window, steps - begin, h)[0, :, 0]
    assert np.abs(foretold - forces[begin:]).max() < 0.1 * np.std(forces)
