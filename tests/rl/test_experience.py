"""What replay is given of a step."""

from contextlib import closing

import numpy as np
import pytest
import torch

from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.experience import Experience
from idapt_pl.tasks import make_task


@pytest.mark.parametrize("errors", [(), [np.random.default_rng(0).normal(size=(50, 4))]])
def test_what_a_step_ends_with_is_what_the_next_begins_with_but_where_an_episode_ended(errors):
    """Errors of estimates go on where the episode does, whoever else's ended."""
    task = make_task("inverted_pendulum")
    teacher = StateSAC(4, [-3.0], [3.0], noise=0.3)
    teacher.recorded_errors = errors
    teacher.actor.encoder.fit(torch.randn(100, 4))
    with closing(VectorStateEnv(task, task.domain("source"), 4)) as env:
        step = Experience(env, teacher, seed=0, random=True)
        before, ended_alone = step(), 0
        for _ in range(60):
            ended, now = step.ended, step()
            ended_alone += ended.any() and not ended.all()
            np.testing.assert_array_equal(now["observation"][~ended], before["next_observation"][~ended])
            assert not np.isclose(now["observation"], now["state"]).all(), "there are errors"
            before = now
    assert ended_alone > 3
