"""Exploring episodes cut where physics loses them: once, in source and target, whatever kills the run meanwhile."""

import json

import numpy as np
import pytest
import torch
from conftest import TINY

from cli.main import main
from datamodules import read_trajectories
from idapt_pl.envs.ledger import Ledger
from idapt_pl.report.run_record import read_run_record
from idapt_pl.run_folder.kept_warnings import read_warnings
from idapt_pl.run_folder.time_left import TimeLeft
from idapt_pl.smoothing import Smoothed
from idapt_pl.stages import cut_episodes, labels
from idapt_pl.stages.labels import lost_from

STEPS = 6
"""From which on physics is made to lose the target's episodes."""
CUT = TINY | {
    "teacher.steps": 16, "teacher.adapt": 12, "teacher.dagger": 0, "teacher.rehearse": 64, "teacher.noise": 0.1,
    "teacher.harden": 0, "teacher.rounds": 1, "policy.memory": 8, "filter.stretch": 10, "labels.members": 8,
    "labels.lag": 1, "schedule.grounding_steps": 1, "schedule.source_policy": 0, "schedule.paired_steps": 2,
    "effects.discover": "true", "effects.refine": "true", "effects.candidates": "[body_mass]",
    **{f"schedule.{part}.{name}": n for part in ("pretrain", "finetune")
       for name, n in (("policy", 0), ("rehearsed", 4), ("filter", 6))},
    "threads": 1, "side_by_side": "false",
}  # fmt: skip


def fit(folder, **others):
    config = ["--config", "configs/pendulum_quick.yaml", "--run_dir", str(folder)]
    return main(["fit", *config, *(f"--{k}={v}" for k, v in (CUT | others).items())])


def losing(smoothed):
    """What a smoother finds, but lost from a control step on."""
    return [Smoothed(s.states, s.surprise, np.arange(len(s.lost)) >= STEPS) for s in smoothed]


@pytest.fixture
def falling(monkeypatch):
    """A target that physics loses, in whatever process and at whatever horizon it is looked at."""
    found = labels.RecordingSmoother.__call__
    monkeypatch.setattr(labels.RecordingSmoother, "__call__", lambda self, r, seed: losing(found(self, r, seed)))


def checkpoint(folder, name):
    return torch.load(folder / f"step_00/{name}/final.ckpt", weights_only=True)["state_dict"]


def same(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cut") / "run"
    with pytest.MonkeyPatch.context() as patch:
        falling.__wrapped__(patch)
        assert fit(folder) == 0
    return folder


def test_what_is_seen_after_a_loss_takes_no_part_in_what_g_learns(cut):
    first = cut / "step_00"
    for name in ("source", "target"):
        whole, kept = (read_trajectories(first / f"{n}.h5") for n in (name, f"{name}_cut"))
        assert max(map(len, whole)) > STEPS == max(map(len, kept)) and len(kept) == len(whole)
        for long, short in zip(whole, kept, strict=True):
            pixels = long.observations["pixels"][: len(short) + 1]
            assert (pixels == short.observations["pixels"]).all()
    assert max(map(len, read_trajectories(first / "translated.h5"))) == STEPS
    assert max(map(len, read_trajectories(first / "control.h5"))) <= STEPS, "the sensor is judged by such episodes too"
    assert not same(checkpoint(cut, "uncut_visual"), checkpoint(cut, "visual"))


def test_it_is_said_once_and_target_steps_are_counted_once(cut):
    told = [w for w in read_warnings(cut) if "cut after 6 control steps" in w]
    assert len(told) == 1 and not any("often disagree" in w and "target.h5" not in w for w in read_warnings(cut))
    training = sum(e["count"] for e in Ledger(cut / "ledger.json").entries if e["purpose"] == "training")
    assert training == sum(read_trajectories(p).total_steps for p in cut.glob("step_*/target.h5"))


def test_the_record_of_a_run_has_both_trainings_with_their_times(cut):
    seconds = read_run_record(cut).steps[0].seconds
    stages = {name: json.loads((cut / f"step_00/{name}/stage.json").read_text()) for name in ("visual", "uncut_visual")}
    for name, told in stages.items():
        assert told["stage"] == name and seconds[name] == told["wall_s"]
    assert list(seconds).index("uncut_visual") + 1 == list(seconds).index("visual")
    assert {"cut", "lost", "uncut_lost", "known_start_search", "uncut_known_start_search"} <= set(seconds)


def test_a_run_that_is_killed_while_it_puts_things_aside_ends_the_same(cut, tmp_path, falling, monkeypatch):
    rename, left = cut_episodes.rename, [3]

    def dying(path, new):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        rename(path, new)

    with monkeypatch.context() as patch:
        patch.setattr(cut_episodes, "rename", dying)
        assert fit(tmp_path / "run") != 0
    assert (tmp_path / "run/step_00/lost.json").exists() and (tmp_path / "run/step_00/cut.json").exists()
    assert fit(tmp_path / "run") == 0
    for name in ("uncut_visual", "visual", "estimator", "policy"):
        assert same(checkpoint(tmp_path / "run", name), checkpoint(cut, name)), name
    assert (tmp_path / "run/effects.yaml").read_text() == (cut / "effects.yaml").read_text()


def test_nothing_is_cut_where_nothing_is_lost_or_a_run_is_of_an_earlier_version(tmp_path):
    assert fit(tmp_path / "run", **{"schedule.grounding_steps": 0, "labels.members": 64}) == 0
    folder = tmp_path / "run/step_00"
    told = json.loads((folder / "lost.json").read_text())
    assert told["frames"] == read_trajectories(folder / "target.h5").total_steps + len(
        read_trajectories(folder / "target.h5")
    )
    assert told["from"] is None and not list(folder.glob("*cut*"))
    (folder / "lost.json").unlink()
    before = (folder / "visual/final.ckpt").stat().st_mtime_ns
    assert fit(tmp_path / "run", **{"schedule.grounding_steps": 0, "labels.members": 64}) == 0
    assert not (folder / "lost.json").exists() and (folder / "visual/final.ckpt").stat().st_mtime_ns == before


def lost(*steps):
    return [np.arange(51) >= step for step in steps]


def test_where_recordings_are_lost():
    assert lost_from(lost(18, 20, 23, 60)) == 20
    assert lost_from(lost(20, 60, 60)) is None, "most are never lost"
    assert lost_from(lost(1, 1, 30)) is None, "it is lost from the beginning, so it does not fall"


def test_stages_that_are_done_again_count_again():
    left = TimeLeft({(0, "visual"): 100.0, (0, "policy"): 100.0, (1, "visual"): 50.0})
    assert left.done(0, "visual", 100.0) == pytest.approx(150, rel=0.3)
    left.again(0, ("visual", "labelled"))
    assert left.done(0, "labelled", 1.0) == pytest.approx(250, rel=0.3)
