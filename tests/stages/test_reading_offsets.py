"""Offsets of readings are sought in each of the target's files, and taken from that file's readings."""

import json
from types import SimpleNamespace

import numpy as np
from conftest import numbered_episodes

from datamodules import write_trajectories
from idapt_pl.smoothing import ReadRecording
from idapt_pl.stages import labels


def test_each_file_of_the_target_has_its_own_offset(tmp_path, monkeypatch):
    for name, episodes in (("step_00", 3), ("step_01", 2)):
        (tmp_path / name).mkdir()
        write_trajectories(tmp_path / name / "target.h5", numbered_episodes([4] * episodes))
    recordings = [ReadRecording(np.full((5, 2), float(k)), np.zeros((4, 1))) for k in range(5)]
    asked = []

    def sought(task, domain, mine, scale, begin):
        asked.append(([r.readings[0, 0] for r in mine], begin))
        return np.array([1.0, 0.0]) * len(mine), (0.5, 0.1 if len(mine) == 3 else np.inf)

    monkeypatch.setattr(labels, "reading_offsets", sought)
    files = [tmp_path / name / "target.h5" for name in ("step_00", "step_01")]
    told = labels.offsets_of_files(files, SimpleNamespace(task=None, domain=None), recordings, np.ones(2), 7)
    assert asked == [([0, 1, 2], 7), ([3, 4], 7)]
    assert [(f["episodes"], f["offset"]) for f in told["files"]] == [(3, [3.0, 0.0]), (2, [2.0, 0.0])]
    assert told["spreads"] == [1.0, 1.0]
    assert [f["standard_error"] for f in json.loads(json.dumps(told, allow_nan=False))["files"]] == [0.1, None]
