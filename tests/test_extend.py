"""Every example of docs/guide/extend.md is run as it stands (the effect: tests/effects/test_extend_effect.py)."""

import json
import re
import shutil
import types

import h5py
import numpy as np
import torch
from conftest import ROOT
from scipy.io import savemat

from cli.fit import GroundingCLI
from cli.main import main
from idapt_pl import run as library
from idapt_pl import tasks
from idapt_pl.envs import VectorImageEnv
from idapt_pl.run import Run

PAGE = (ROOT / "docs/guide/extend.md").read_text(encoding="utf-8")


def example(name):
    """The code block after ``<!-- name-example -->``, as a module."""
    code = re.search(rf"<!-- {name}-example -->\n```python\n(.*?)```", PAGE, re.S)
    assert code, f"docs/guide/extend.md has no example after <!-- {name}-example -->"
    module = types.ModuleType(f"extend_{name}")
    exec(compile(code[1], f"extend.md: {name}", "exec"), module.__dict__)
    return module


def test_the_task_can_be_played_collected_and_drawn(monkeypatch, tmp_path):
    task = example("task").Cart
    monkeypatch.setitem(tasks.TASKS, task.name, task)
    for name, domain in task().domains().items():
        env = VectorImageEnv(task(), domain, 1, 32, 2)
        obs, _ = env.reset(seed=0)
        assert obs["pixels"].std() > 0 and obs["state"].shape == (1, 2), name
        env.close()
    out = tmp_path / "d.h5"
    assert main(["collect", "--task", "cart", "--domain", "hard", "--steps", "12", "--out", str(out)]) == 0
    with h5py.File(out) as f:
        assert f.attrs["total_steps"] == 12 and "state" not in f["episode_0/observations"]
    assert main(["gallery", "--task", "cart", "--out", str(tmp_path), "--image-size", "32"]) == 0
    assert "body_mass" in (tmp_path / "index.html").read_text()


def test_the_baseline_is_measured_once_and_is_on_the_ledger(finished_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run, folder)
    before = json.loads((folder / "ledger.json").read_text())["training_total"]
    hold_still = example("baseline").hold_still
    result = hold_still(Run.open(folder), 2)
    assert len(result["returns"]) == 2 and result == hold_still(Run.open(folder), 2), "the second is read from the file"
    ledger = json.loads((folder / "ledger.json").read_text())
    assert ledger["training_total"] == before
    assert result["interactions"] in [e["count"] for e in ledger["entries"] if "holding still" in e["purpose"]]


def test_the_algorithm_is_built_from_a_config(monkeypatch, tiny_args, tmp_path):
    kind = example("algorithm").BoundedSAC
    monkeypatch.setitem(library.MODULES, "policy", kind)
    made = GroundingCLI(tiny_args(tmp_path / "run")).run()
    policy = made.context.new_policy()
    assert type(policy) is kind
    batch = {
        "rewards": torch.tensor([5.0, -7.0]), "actions": policy.actor.center.repeat(2, 1),
        "next_state": torch.zeros(2, 4),
    }  # fmt: skip
    assert policy.shaped_rewards(batch).abs().max() <= 1


def test_the_format_is_read(tmp_path):
    savemat(tmp_path / "log.mat", {"q": np.array([[0.0, 1.0], [0.5, 2.0]]), "t": np.array([[0.0], [0.1]]), "rig": "3"})
    (recorded,) = example("format").read_mat(tmp_path / "log.mat", None)
    np.testing.assert_array_equal(recorded.columns["q[0]"], [0.0, 0.5])
    np.testing.assert_array_equal(recorded.columns["t"], [0.0, 0.1])


def test_the_network_keeps_the_size_of_images():
    net = example("network").DilatedGenerator(channels=3, width=4, blocks=2)
    out = net(torch.randn(2, 3, 24, 32))
    assert out.shape == (2, 3, 24, 32) and out.abs().max() <= 1
