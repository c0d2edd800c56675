"""A teacher pays where no image has been seen, by the states that a step ends in."""

from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.envs import KeptNear, VectorStateEnv
from idapt_pl.stages.distillation import Distillation, TeacherSettings
from idapt_pl.tasks import make_task

RNG = np.random.default_rng(0)
FAMILIAR = 0.03 * RNG.standard_normal((500, 4)).astype(np.float32)
"""States of a pendulum near its upright pose."""


def simulations():
    task = make_task("inverted_pendulum")
    return VectorStateEnv(task, task.domains()["source"], 2)


def played(env, actions):
    """States that steps end in, before any reset, and rewards: (T, n, s), (T, n)."""
    with closing(env):
        env.reset(seed=0)
        steps = [env.step(np.full((2, 1), a, np.float32)) for a in actions]
    return np.array([s[4].get("final_obs", s[0])["state"] for s in steps]), np.array([s[1] for s in steps])


def test_what_is_familiar_costs_nothing_and_what_is_not_costs_all_also_where_an_episode_ends():
    actions = [0.0] * 2 + [3.0] * 40
    states, plain = played(simulations(), actions)
    again, rewards = played(KeptNear(simulations(), FAMILIAR, 0.7), actions)
    np.testing.assert_array_equal(states, again)
    z = (states - FAMILIAR.mean(0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(FAMILIAR.T))).T
    near, far, cost = (z[:2] ** 2).sum(-1), np.abs(z).max(-1) > 10, plain - rewards
    assert cost[:2] == pytest.approx(0.7 * (1 - np.exp(-near / 2)), rel=1e-3) and cost[:2].max() < 0.3
    assert far.any() and cost[far] == pytest.approx(0.7)
    assert (np.abs(states[..., 1]).max(0) > 0.2).all(), "both fell, and paid for where they fell"


def test_a_component_that_never_varies_does_not_matter():
    still = np.concatenate([FAMILIAR[:, :2], np.zeros((500, 2), np.float32)], 1)
    states, plain = played(simulations(), [3.0])
    _, rewards = played(KeptNear(simulations(), still, 1.0), [3.0])
    m = (states[0, :, :2] - still[:, :2].mean(0)) @ np.linalg.inv(np.cov(still[:, :2].T))
    expected = 1 - np.exp(-0.5 * (m * (states[0, :, :2] - still[:, :2].mean(0))).sum(1))
    assert (plain - rewards)[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("cost", "recorded"), [(0.0, True), (0.5, False), (0.5, True)])
def test_a_teacher_pays_once_the_source_s_data_are_recorded(tmp_path, cost, recorded):
    if recorded:
        pixels = np.zeros((500, 4, 4, 3), np.uint8)
        episode = Episode(np.zeros((499, 1), np.float32), {"pixels": pixels, "state": FAMILIAR})
        write_trajectories(tmp_path / "source.h5", Trajectories((episode,), 0.04, "near upright"))
    teacher = SimpleNamespace(
        settings=TeacherSettings(steps=1, rehearse=1, unfamiliarity_cost=cost),
        stages=SimpleNamespace(folder=lambda step: tmp_path),
    )
    with closing(simulations()) as env:
        trains_in = Distillation.kept_near(teacher, env)
        assert isinstance(trains_in, KeptNear) == bool(cost and recorded)
        if cost and recorded:
            np.testing.assert_allclose(trains_in.mean, FAMILIAR.mean(0), atol=1e-7)
