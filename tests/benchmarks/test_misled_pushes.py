"""A misread state is one of a world in which hand, puck and goal are elsewhere."""

import numpy as np
import pytest

from benchmarks.misled_pushes import GOAL, GOAL_TO_PUCK, HAND, PUCK, PUCK_TO_HAND, misread, reached, trained
from idapt_pl.envs import VectorStateEnv
from idapt_pl.tasks import make_task


def test_what_lies_between_is_misread_alike():
    task = make_task("sawyer_push")
    env = VectorStateEnv(task, task.domain("source"), 3)
    states = env.reset(seed=0)[0]["state"]
    env.close()
    errors = 0.02 * np.random.default_rng(0).standard_normal((3, 3, 2))
    for seen in (states, misread(states, errors)):
        np.testing.assert_allclose(seen[:, PUCK_TO_HAND], seen[:, HAND] - seen[:, PUCK], atol=1e-6)
        np.testing.assert_allclose(seen[:, GOAL_TO_PUCK], seen[:, PUCK] - seen[:, GOAL], atol=1e-6)
    for part, error in zip((HAND, PUCK, GOAL), errors.transpose(1, 0, 2), strict=True):
        np.testing.assert_allclose(misread(states, errors)[:, part] - states[:, part], error, atol=1e-6)
    changed = (misread(states, errors) != states).any(0).nonzero()[0]
    assert set(changed) == {i for s in (HAND, PUCK, GOAL, PUCK_TO_HAND, GOAL_TO_PUCK) for i in range(40)[s]}


@pytest.mark.slow
def test_one_that_has_learned_nothing_reaches_no_goal(tmp_path):
    task = make_task("sawyer_push")
    assert reached(task, task.domain("source"), trained(task, 8, 0.0, 0, tmp_path), 0.0) < 0.2
