"""A target that ends a policy's episodes sooner than the grounded source is told of."""

import logging

import numpy as np
import pytest
from conftest import TINY

from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.run_folder.kept_warnings import read_warnings
from idapt_pl.stages import episode_lengths
from idapt_pl.stages.episode_lengths import lengths_of, warn_if_ended_sooner


def recording(path, lengths):
    def episode(n):
        return Episode(np.zeros((n, 1), np.float32), {"pixels": np.zeros((n + 1, 8, 8, 3), np.uint8)})

    write_trajectories(path, Trajectories(tuple(map(episode, lengths)), 0.1, "test"))
    return path


def test_an_episode_left_unfinished_is_no_length_unless_it_is_the_only_one(tmp_path):
    assert lengths_of(recording(tmp_path / "a.h5", [7, 9, 3])) == [7, 9]
    assert lengths_of(recording(tmp_path / "b.h5", [5])) == [5]


@pytest.mark.parametrize(
    ("target", "source", "told"),
    [
        ([17, 19, 18, 2], [500, 484], True),
        ([17, 19, 18, 2], [30, 40, 20, 12], False),  # both fall
        ([500, 500], [500, 500], False),
        ([50, 120, 90, 30], [200, 80, 150, 20], False),  # sooner, and not much
    ],
)
def test_it_is_told_where_the_target_ends_what_the_source_goes_on_with(tmp_path, caplog, target, source, told):
    files = recording(tmp_path / "source.h5", source), recording(tmp_path / "target.h5", target)
    with caplog.at_level(logging.WARNING):
        warn_if_ended_sooner(2, *files)
    assert bool(caplog.records) == told
    if told:
        message = caplog.records[0].getMessage()
        assert "last 18 control steps in the target and 500 in" in message and "of step_02" in message


def test_a_run_asks_after_each_recording_of_its_policy_and_keeps_what_it_is_told(tmp_path, monkeypatch):
    asked = []
    told = episode_lengths.log.warning

    def asking(k, source, target):
        asked.append((k, source.parent.name, source.name, target.name))
        told("step %d  sooner", k)

    monkeypatch.setattr("idapt_pl.grounding.warn_if_ended_sooner", asking)
    config = ["fit", "--config", "configs/pendulum_quick.yaml", "--run_dir", str(tmp_path / "run")]
    settings = TINY | {"schedule.grounding_steps": 1}
    assert main([*config, *(f"--{key}={value}" for key, value in settings.items())]) == 0
    assert asked == [(1, "step_01", "source.h5", "target.h5")]
    assert "step 1  sooner" in read_warnings(tmp_path / "run")
