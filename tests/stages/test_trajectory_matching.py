"""Trajectory matching: a planted action law is recovered, and the identity where nothing is planted."""

import mujoco
import numpy as np
import pytest
import torch

from idapt_pl.effects.actuators import ActuatorDeadzone
from idapt_pl.effects.joints import JointStribeck
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.modules import ActionTransformation
from idapt_pl.stages.trajectory_matching import (
    MatchingWindows,
    TrajectoryMatching,
    cut_windows,
    initialise_by_matching,
)
from idapt_pl.tasks import make_task


class States(torch.nn.Module):
    """An encoder whose features are standardised states."""

    features = 4

    def __init__(self):
        super().__init__()
        self.register_buffer("mean", torch.zeros(4))
        self.register_buffer("std", torch.tensor([0.1, 0.1, 0.5, 1.0]))

    def encode(self, pixels):
        raise AssertionError("matching sees no images")


@pytest.fixture
def F():
    low, high = [-3.0], [3.0]
    made = ActionTransformation(encoder=States(), action_low=low, action_high=high, hidden=(8,), smoothing=1.0)
    made.feature_std.copy_(torch.ones(4))
    return made


def recorded(law, noise, seed=0):
    """Episodes of the source moved by ``law(state, action)``: states, actions, index of each episode's first row."""
    task = make_task("inverted_pendulum")
    model = task.domain("source").compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    states, actions, first = [], [], []
    for _ in range(40):
        mujoco.mj_resetData(model, data)
        task.reset(model, data, rng)
        begin = len(states)
        for _ in range(12):
            a = rng.uniform(-3, 3, 1)
            s = task.state(model, data)
            states.append(s + noise * rng.normal(size=4)), actions.append(a), first.append(begin)
            data.ctrl[:] = law(s, a)
            mujoco.mj_step(model, data, task.frame_skip)
    tensors = (torch.tensor(np.array(x), dtype=torch.float32) for x in (states, actions))
    return (task, task.domain("source"), *tensors, np.array(first))


def transformed(F, state, action):
    """F's action at a state."""
    x = F.agent_input((torch.tensor([state]) - F.encoder.mean) / F.encoder.std, torch.tensor([[action]]))
    with torch.no_grad():
        return float(F.apply_residual(torch.tensor([[action]]), F.residual(x).mean))


def test_a_planted_law_is_recovered(F):
    left = initialise_by_matching(F, *recorded(lambda s, a: 0.3 * a - 2.0 * s[1], 3e-4), ridge=1.0)
    assert left < 2e-3
    for theta, a in ((0.0, 2.0), (0.1, 0.0), (-0.1, -2.0)):
        assert transformed(F, [0.0, theta, 0.0, 0.0], a) == pytest.approx(0.3 * a - 2.0 * theta, abs=0.05)


def test_a_law_of_positions_does_not_use_velocities(F):
    """They would take part in explaining noise; held-out episodes tell that they do not help."""
    initialise_by_matching(F, *recorded(lambda s, a: 0.3 * a - 2.0 * s[1], 2e-3), ridge=1.0)
    assert (F.affine.weight[0, 2:4] == 0).all()
    assert (F.affine.weight[0, [1, 4]] != 0).all()


def test_a_law_with_damping_uses_velocities(F):
    initialise_by_matching(F, *recorded(lambda s, a: 0.5 * a + 1.0 * s[3], 1e-4), ridge=1.0)
    assert transformed(F, [0.0, 0.0, 0.0, 1.0], 0.0) == pytest.approx(1.0, abs=0.1)


def test_one_long_episode_is_halved(F):
    task, source, states, actions, first = recorded(lambda s, a: 0.3 * a, 1e-4)
    one = first * 0
    inside = np.arange(len(one)) < 12  # the others would follow on from it
    initialise_by_matching(F, task, source, states[inside], actions[inside], one[inside], ridge=1.0)
    assert transformed(F, [0.0] * 4, 2.0) == pytest.approx(0.6, abs=0.2)


def test_the_identity_is_recovered_where_nothing_is_planted(F):
    initialise_by_matching(F, *recorded(lambda s, a: a, 3e-4), ridge=1.0)
    for theta, a in ((0.0, 2.0), (0.1, 0.0), (-0.1, -2.0)):
        assert transformed(F, [0.0, theta, 0.0, 0.0], a) == pytest.approx(a, abs=0.05)


def test_windows_do_not_cross_an_episodes_end():
    first = np.array([0, 0, 0, 0, 4, 4, 4, 4, 4])
    seen = cut_windows(np.arange(9.0)[:, None], np.arange(9.0)[:, None], first, length=3, stride=1)
    assert seen.qpos[:, 0, 0].tolist() == [0, 4, 5]
    assert seen.actions[1, :, 0].tolist() == [4, 5, 6]


def test_too_short_episodes_are_refused():
    with pytest.raises(ValueError, match="no episode in the target lasts 5 control steps"):
        cut_windows(np.zeros((6, 1)), np.zeros((6, 1)), np.array([0, 0, 0, 3, 3, 3]), 5, 1)


@pytest.mark.parametrize(
    "effect",
    [
        None, ActuatorDelay("slide", 0.1), ActuatorLag("slide", 0.08), ActuatorDeadzone("slide", 1.0),
        JointStribeck("slider", 2.0, 4.0, 0.1),
    ],
)  # fmt: skip
def test_what_is_replayed_is_what_the_repaired_source_does(effect):
    """Also where a lag or a delay was found, whose actuators remember: a replay begins with nothing remembered."""
    task, rng = make_task("inverted_pendulum"), np.random.default_rng(0)
    source = task.domain("source").with_effects(*[effect] * (effect is not None))
    model = source.compile()
    actions = rng.uniform(-3, 3, (3, 8, 1))
    starts = rng.uniform(-0.05, 0.05, (3, 4))
    expected = np.zeros((3, 9, 2))
    for n in range(3):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = starts[n, :2], starts[n, 2:]
        expected[n, 0] = data.qpos
        for t in range(8):
            task.play(model, data, source.command(model, actions[n, t : t + 1])[0])
            expected[n, t + 1] = data.qpos
    windows = MatchingWindows(expected, actions, np.arange(3))
    matching = TrajectoryMatching(task, source, windows, lambda parameters, states, a: a)
    replayed = matching.replay(np.zeros(0), starts[:, :2], starts[:, 2:]).reshape(expected.shape)
    np.testing.assert_allclose(replayed, expected, atol=1e-9)
    assert np.abs(expected[:, -1] - expected[:, 0]).max() > 0.05
