"""A target that ends a policy's episodes sooner than the grounded source is told of."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TINY

from cli.main import main
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from idapt_pl.run_folder.kept_warnings import read_warnings
from idapt_pl.stages import episode_lengths
from idapt_pl.stages.episode_lengths import lengths_of, warn_if_ended_sooner
from idapt_pl.stages.labels import first_episodes
from idapt_pl.targets import RecordedTarget, SimulatedTarget


def recording(path, lengths):
    def episode(n):
        return Episode(np.zeros((n, 1), np.float32), {"pixels": np.zeros((n + 1, 8, 8, 3), np.uint8)})

    write_trajectories(path, Trajectories(tuple(map(episode, lengths)), 0.1, "test"))
    return path


def towards(kind):
    """A run's context with a target of some kind, as far as it is looked at."""
    return SimpleNamespace(worlds=SimpleNamespace(target=object.__new__(kind)))


def test_what_factors_are_judged_by_is_the_beginning_of_as_many_episodes_as_are_needed(tmp_path):
    def kept(lengths):
        return [len(e) for e in first_episodes(read_trajectories(recording(tmp_path / "k.h5", lengths)))]

    assert kept([500, 500, 500]) == [200, 200] and kept([150]) == [150]
    assert kept([300, *[50] * 9]) == [200, *[50] * 4]


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
        warn_if_ended_sooner(towards(SimulatedTarget), 2, *files)
        warn_if_ended_sooner(towards(RecordedTarget), 2, *files)
    assert len(caplog.records) == told, "recordings that people brought may end for other reasons"
    if told:
        message = caplog.records[0].getMessage()
        assert "last 18 control steps in the target and 500 in" in message and "of step_02" in message


def test_a_run_asks_after_each_recording_of_its_policy_and_keeps_what_it_is_told(tmp_path, monkeypatch):
    asked = []
    told = episode_lengths.log.warning

    def asking(c, k, source, target):
        asked.append((k, source.parent.name, source.name, target.name))
        told("step %d  sooner", k)

    monkeypatch.setattr("idapt_pl.grounding.warn_if_ended_sooner", asking)
    config = ["fit", "--config", "configs/pendulum_quick.yaml", "--run_dir", str(tmp_path / "run")]
    settings = TINY | {"schedule.grounding_steps": 1}
    assert main([*config, *(f"--{key}={value}" for key, value in settings.items())]) == 0
    assert asked == [(1, "step_01", "source.h5", "target.h5")]
    assert "step 1  sooner" in read_warnings(tmp_path / "run")
