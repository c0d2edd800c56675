"""Policies as files for the robot: they act as the run's do, and need nothing of it."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import torch

from cli.main import main
from datamodules.images.fitting import Fitted
from idapt_pl.deployment.onnx_policy import DeployedPolicy, export_policy, played_by_file
from idapt_pl.deployment.play import PlayedPolicy
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import deterministic

pytest.importorskip("onnxscript")
pytest.importorskip("onnxruntime")
PLAIN = (np.array([0, 1]), np.ones(2), np.zeros(2), np.array([-1.0, -2.0]), np.array([1.0, 2.0]))


def policy_with(memory=0, encoder="supervised"):
    torch.manual_seed(0)
    policy = AsymmetricSAC(3, [-1.0, -2.0], [1.0, 2.0], 16, 2, hidden=[16], encoder=encoder, memory=memory, bf16=False)
    with torch.no_grad():
        for parameter in policy.actor.head.parameters():
            parameter.mul_(3.0)  # actions that differ from frame to frame
        if policy.filter is not None:
            torch.nn.init.normal_(policy.filter.correction[-1].weight, std=0.3)
    return policy.eval()


def frames(n=12):
    return np.random.default_rng(0).integers(0, 256, (n, 2, 16, 16, 3), np.uint8)


def acted(policy, stacks):
    act = deterministic(policy)
    return np.array([act(stack[None])[0] for stack in stacks]), act


@pytest.mark.parametrize(("memory", "encoder"), [(0, "supervised"), (8, "supervised"), (0, "learned")])
def test_a_file_acts_as_the_policy_does(tmp_path, memory, encoder):
    policy, stacks = policy_with(memory, encoder), frames()
    expected, _ = acted(policy, stacks)
    assert np.ptp(expected, 0).min() > 0.01, "actions must differ for this to compare anything"
    export_policy(DeployedPolicy(policy, *PLAIN), tmp_path / "p.onnx", 2, 16, {})
    np.testing.assert_allclose(played_by_file(tmp_path / "p.onnx", stacks), expected, atol=1e-5)
    if memory:
        alone = np.array([played_by_file(tmp_path / "p.onnx", stack[None])[0] for stack in stacks])
        assert np.abs(alone - expected)[1:].max() > 1e-3, "what it remembers must matter"


def test_a_file_begins_anew_where_the_state_is_lost(tmp_path):
    policy, stacks = policy_with(8), frames()
    readings = policy.encode(stacks)
    with torch.no_grad():
        estimates, memory = [], policy.filter.begin(1)
        for reading in readings:
            estimates.append(policy.filter.step(reading[None], memory)[0])
            memory.action = policy.actor.normalise(policy.actor(estimates[-1][None], True)[0])
    usual = (readings - torch.stack(estimates)).abs()
    policy.filter.usual_correction.copy_(usual.median(0).values / 3)  # lost in some steps, and not in others
    expected, act = acted(policy, stacks)
    assert 0.1 < act.lost < 0.95
    export_policy(DeployedPolicy(policy, *PLAIN), tmp_path / "p.onnx", 2, 16, {})
    np.testing.assert_allclose(played_by_file(tmp_path / "p.onnx", stacks), expected, atol=1e-5)


def test_actions_are_in_the_robots_order_units_and_bounds(tmp_path):
    policy, stacks = policy_with(), frames()
    expected, _ = acted(policy, stacks)
    low, high = np.array([-1.0, -9.0]), np.array([1.0, 9.0])
    there = (np.array([1, 0]), np.array([10.0, -1.0]), np.array([0.0, 0.5]), low, high)
    export_policy(DeployedPolicy(policy, *there), tmp_path / "p.onnx", 2, 16, {})
    told = np.clip(np.column_stack([10 * expected[:, 1], 0.5 - expected[:, 0]]), low, high)
    np.testing.assert_allclose(played_by_file(tmp_path / "p.onnx", stacks), told, atol=1e-4)


def test_a_run_is_exported_and_played_without_this_project(finished_run, tmp_path, capsys):
    out = tmp_path / "robot" / "policy.onnx"
    out.parent.mkdir()
    assert main(["export", "--run", str(finished_run), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "step_02/policy/final.ckpt" in said and "ms on one core" in said
    script = "import sys; sys.modules['idapt_pl'] = sys.modules['torch'] = sys.modules['mujoco'] = None; "
    script += "import runpy; sys.argv = ['play.py', 'policy.onnx', *sys.argv[1:]]; "
    script += "runpy.run_path('play.py', run_name='__main__')"

    def play(*options):
        return subprocess.run(
            [sys.executable, "-c", script, *options], cwd=out.parent, capture_output=True, text=True, check=False
        )

    about = json.loads(play("--about").stdout)
    assert (about["image_size"], about["frames"], about["memory"], about["period"]) == (32, 3, 0, 0.04)
    assert (about["low"], about["high"], about["actions"]) == ([-3.0], [3.0], ["slide"])
    dry = play("--dry-run", "--seconds", "0.2")
    assert dry.returncode == 0 and "5 control steps of 0.04 s" in dry.stdout
    missing = play("--seconds", "0.1")
    assert missing.returncode == 1 and "fill in get_image()" in missing.stderr


def test_play_fills_the_stack_limits_changes_and_never_sends_nan(tmp_path):
    policy, stacks = policy_with(), frames()
    export_policy(DeployedPolicy(policy, *PLAIN), tmp_path / "p.onnx", 2, 16, {"low": [-1.0, -2.0], "high": [1.0, 2.0]})
    images, play = stacks[:, -1], PlayedPolicy(tmp_path / "p.onnx")
    seen = np.stack([images[[0, 0]], images[[0, 1]], images[[1, 2]]])
    np.testing.assert_allclose([play(image) for image in images[:3]], acted(policy, seen)[0], atol=1e-5)
    slow = PlayedPolicy(tmp_path / "p.onnx", limit=0.01)
    actions = np.array([slow(image) for image in images])
    assert np.abs(np.diff(actions, axis=0)).max(0) == pytest.approx([0.02, 0.04], rel=1e-3)
    slow.begin(np.array([1.0, 9.0]))  # what the robot is told before; 9 is out of bounds
    assert np.abs(slow(images[0]) - [1.0, 2.0]).max() <= 0.04 + 1e-6
    slow.begin()
    assert np.array_equal(slow(images[0]), actions[0]), "without it the first action may be any"
    for shape in ((48, 96, 3), (17, 16, 3), (9, 12, 3)):
        image = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
        assert np.array_equal(play.square(image), Fitted(16, 16, "crop")(image)), "as the run has seen it"
    with torch.no_grad():
        policy.actor.head[-1].bias.fill_(float("nan"))
    export_policy(
        DeployedPolicy(policy, *PLAIN), tmp_path / "nan.onnx", 2, 16, {"low": [-1.0, -2.0], "high": [1.0, 2.0]}
    )
    assert np.isfinite(PlayedPolicy(tmp_path / "nan.onnx")(images[0])).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "policy.pt"], r"the ending must be \.onnx"),
        (["--out", "p.onnx", "--step", "7"], "has policies of the steps 0, 1, 2"),
    ],
)
def test_what_cannot_be_exported_is_one_sentence(finished_run, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "--run", str(finished_run), *options]) == 1
    assert re.search(message, capsys.readouterr().err) and not list(tmp_path.iterdir())
