"""Algorithm 1 from start to end on the tasks beside the pendulum, tiny, as their quick configs have it."""

import json

import pytest
import yaml
from conftest import ROOT, TINY

from cli.main import main
from datamodules import read_trajectories
from idapt_pl.tasks import make_task
from idapt_pl.tasks.recipe import ExpertRecipe

SHORT = {"teacher.steps": 8, "teacher.adapt": 8, "schedule.grounding_steps": 1, "randomisation.ranges": "null"}
"""TINY seeks no effects, so none can be drawn."""
DAGGER = SHORT | {"teacher.dagger": 8}
ON_ESTIMATES = SHORT | {
    "teacher.rehearse": 64, "teacher.harden": 8, "policy.memory": 8, "filter.stretch": 10, "labels.members": 8,
    "schedule.source_policy": 0,
    **{f"schedule.{part}.{name}": n for part in ("pretrain", "finetune")
       for name, n in (("policy", 0), ("rehearsed", 4), ("filter", 6))},
}  # fmt: skip
"""A teacher's stages, and those of what learns from it; TINY has the other lengths."""


@pytest.mark.parametrize(
    "config",
    ["walker_quick", *(pytest.param(f"{t}_quick", marks=pytest.mark.slow) for t in ("cheetah", "fetch", "sawyer"))],
)
def test_a_quick_config_runs_from_start_to_end(config, tmp_path, monkeypatch):
    path, run = ROOT / f"configs/{config}.yaml", tmp_path / "run"
    task = make_task(yaml.safe_load(path.read_text())["task"])
    monkeypatch.setattr(type(task), "expert", ExpertRecipe(8, batch=8, warmup_steps=40, num_envs=2))
    # whether there is an F, and what is explored by, is the config's
    rehearses = "rehearse" in yaml.safe_load(path.read_text())["teacher"]
    values = {k: v for k, v in TINY.items() if k != "schedule.action_transformation"} | {"run_dir": run}
    values |= ON_ESTIMATES if rehearses else DAGGER
    assert main(["fit", "--config", str(path), *(f"--{k}={v}" for k, v in values.items())]) == 0

    made = yaml.safe_load((run / "config.yaml").read_text())
    assert made["schedule"]["exploration"] == "rehearse" and made["teacher"]["steps"]
    stages = {p.parent.name for p in run.glob("step_01/*/final.ckpt")}
    learned = {"estimator_policy", "filter_policy"} if rehearses else {"estimator", "student"}
    assert {"state_predictor", "visual", "policy"} | learned <= stages
    assert (run / "step_01/labelled.h5").exists() == rehearses
    assert ("dynamics" in stages) == made["schedule"]["action_transformation"]
    assert (run / "step_00/source_teacher/final.ckpt").exists() and (run / "report.html").exists()

    summary = json.loads((run / "summary.json").read_text())
    expected = TINY["schedule.images"] + TINY["schedule.interactions"]
    assert (summary["task"], summary["target_interactions"]) == (task.name, expected)
    assert len(summary["grounded"]) == 1 and summary["metric"] == task.metric
    for episode in read_trajectories(run / "step_01/target.h5"):
        assert set(episode.observations) == {"pixels"} and episode.rewards is None
