"""Work that is set aside into another process leaves what it would have left in this one."""

import json
import shutil
import time
from pathlib import Path

import pytest
import torch

from cli.aside import OtherProcesses, processes_beside, why
from cli.main import main


def measured(folder: Path) -> dict:
    """What an evaluation measured, without how long it took."""
    return {k: v for k, v in json.loads(folder.read_text()).items() if k not in ("wall_s", "checksum")}


@pytest.fixture
def unmeasured(finished_run, tmp_path):
    """A copy of a finished run whose last evaluation is still to be made."""
    run = shutil.copytree(finished_run, tmp_path / "run")
    (run / "step_02/evaluation.json").unlink()
    return run


@pytest.mark.slow
def test_an_evaluation_in_another_process_is_the_same(unmeasured, finished_run):
    last = unmeasured / "step_02/evaluation.json"
    aside = OtherProcesses(unmeasured, 1)
    result = aside("evaluation_2", last, lambda: measured(last))
    assert len(aside.running) == 1
    assert result() == measured(last) == measured(finished_run / "step_02/evaluation.json")


def test_what_is_there_already_is_not_set_aside(finished_run):
    aside = OtherProcesses(finished_run, 1)
    assert aside("evaluation_2", finished_run / "step_02/evaluation.json", lambda: "loaded")() == "loaded"
    assert aside.running == []


def test_more_than_there_are_cores_for_is_done_in_turn(tmp_path, monkeypatch):
    monkeypatch.setattr("cli.aside.subprocess.Popen", lambda *a, **k: pytest.fail("a process was started"))
    assert OtherProcesses(tmp_path, 0)("evaluation_2", tmp_path / "none", lambda: "done here")() == "done here"


def test_what_went_wrong_is_told_by_the_command_that_waits(unmeasured):
    (unmeasured / "step_02/policy/final.ckpt").write_bytes(b"no checkpoint")
    result = OtherProcesses(unmeasured, 1)("evaluation_2", unmeasured / "step_02/evaluation.json", dict)
    with pytest.raises(RuntimeError, match=r"final\.ckpt"):
        result()


def test_an_end_without_a_word_is_explained():
    assert "ended by signal 9; the same command goes on" in why("", -9, "evaluation_0")
    assert "exit code 3" in why("not json", 3, "evaluation_0")
    assert why('the robot says hello\n{"error": "no camera"}\n', 1, "evaluation_0") == "no camera"


@pytest.mark.parametrize("after", [0.0, 0.2, 0.5, 1.0])
def test_it_does_not_outlive_the_process_that_started_it(after, unmeasured):
    """Whether it has just begun, imports torch or works: pipes close with a process, whatever ends it."""
    aside, last = OtherProcesses(unmeasured, 1), unmeasured / "step_02/evaluation.json"
    aside("evaluation_2", last, dict)
    (child,) = aside.running
    time.sleep(after)
    child.stdin.close()
    assert child.wait(timeout=3) == 1 and not last.exists()


@pytest.mark.parametrize(("wanted", "threads", "gpu", "expected"), [
    (None, 1, False, 0), (None, 2, False, 1), (None, 8, False, 7), (None, 8, True, 0),
    (True, 1, True, 1), (False, 8, False, 0),
])  # fmt: skip
def test_processes_are_set_beside_where_there_are_cores_for_them(monkeypatch, wanted, threads, gpu, expected):
    monkeypatch.setattr("cli.aside.usable_threads", lambda: threads)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
    assert processes_beside(wanted) == expected


@pytest.mark.slow
def test_a_run_side_by_side_is_the_run_in_turn_to_the_bit(finished_run, tiny_args, tmp_path):
    run = tmp_path / "run"
    assert main(["fit", *tiny_args(run, side_by_side="true")]) == 0
    checkpoints = sorted(p.relative_to(finished_run) for p in finished_run.rglob("final.ckpt"))
    assert len(checkpoints) > 10
    for name in checkpoints:
        ours, theirs = (torch.load(f / name, weights_only=True)["state_dict"] for f in (run, finished_run))
        assert all(torch.equal(v, theirs[k]) for k, v in ours.items()), name
    for name in ("step_00/direct_transfer.json", *(f"step_0{k}/evaluation.json" for k in range(3))):
        assert measured(run / name) == measured(finished_run / name)
    ledgers = [json.loads((f / "ledger.json").read_text()) for f in (run, finished_run)]
    order = [sorted(ledger["entries"], key=str) for ledger in ledgers]
    assert order[0] == order[1]
