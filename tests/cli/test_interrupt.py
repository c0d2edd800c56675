"""Ctrl-C and SIGTERM: one line that says what is kept, a code that says it did not finish, no process left."""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import yaml
from conftest import ROOT

from cli.interrupt import ONE_PRESS, Interrupted, interruptible
from cli.main import main

ON_ESTIMATES = {
    "teacher__steps": 16, "teacher__adapt": 12, "teacher__harden": 12, "teacher__dagger": 0, "teacher__rehearse": 64,
    "policy__memory": 8, "filter__stretch": 10, "labels__members": 8, "schedule__source_policy": 0,
    **{f"schedule__{part}__{name}": n for part in ("pretrain", "finetune")
       for name, n in (("policy", 0), ("rehearsed", 4), ("filter", 6))},
}  # fmt: skip
"""A teacher that acts on what a filter makes of readings."""
CODES = {signal.SIGINT: (130, "Ctrl-C"), signal.SIGTERM: (143, "SIGTERM")}


def stopped(command, begun, signals, delay=0.5, within=240):
    """Exit code and stderr of a command that is sent signals once ``begun()``; none of its group may be left."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "IDAPT_RENDERER": "classic"}
    process = subprocess.Popen(
        [sys.executable, "-m", "cli", *map(str, command)],
        env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0,
    )  # fmt: skip
    until = time.monotonic() + within
    while not begun() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.05)
    assert begun(), f"it did not come so far, exit code {process.poll()}"
    time.sleep(delay)
    for number in signals:
        os.killpg(process.pid, number)
    said = process.communicate(timeout=max(60, within))[
        1
    ]  # waits for whoever else holds stderr, such as processes that render
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
    return process.returncode, said


@contextlib.contextmanager
def handlers_put_back():
    before = [signal.getsignal(n) for n in CODES]
    try:
        yield
    finally:
        for n, handler in zip(CODES, before, strict=True):
            signal.signal(n, handler)


LONG = 1_000_000
STAGES = {
    "recording": ({"schedule__images": LONG}, "run.json"),
    "looks": ({"effects__looks": "true"}, "step_00/target.h5"),
    "P_S": ({"schedule__pretrain__state_predictor": LONG}, "step_00/state_predictor/hparams.yaml"),
    "SAC": ({"schedule__source_policy": LONG}, "step_00/source_policy/hparams.yaml"),
    "SAC beside G": (
        {"schedule__source_policy": LONG, "schedule__pretrain__visual": LONG, "side_by_side": "true", "threads": 1},
        "step_00/source_policy/hparams.yaml",
    ),
    "evaluation": ({"episodes": LONG}, "step_00/source_policy/final.ckpt"),
    "G": ({"schedule__pretrain__visual": LONG}, "step_00/visual/hparams.yaml"),
    "estimator": ({"schedule__pretrain__estimator": LONG}, "step_00/estimator/hparams.yaml"),
    "control": ({"effects__discover": "true", "schedule__images": 3000}, "step_00/estimator/final.ckpt"),
    "effects": ({"effects__discover": "true", "schedule__images": 400}, "step_00/control.h5"),
    "convergence": ({"schedule__until_settled": "true"}, "step_01/target.h5"),
    "F": ({"schedule__finetune__dynamics": LONG}, "step_01/dynamics/hparams.yaml"),
    "teacher": ({"teacher__steps": LONG, "teacher__dagger": 16}, "step_00/source_teacher/hparams.yaml"),
    "student": ({"teacher__steps": 16, "teacher__dagger": LONG}, "step_00/source_student/hparams.yaml"),
    "rehearsal": (ON_ESTIMATES | {"teacher__rehearse": LONG}, "step_00/source_start/final.ckpt"),
    "encoder": (
        ON_ESTIMATES | {"schedule__pretrain__rehearsed": LONG}, "step_00/source_estimator_teacher/hparams.yaml",
    ),
    "filter": (ON_ESTIMATES | {"schedule__pretrain__filter": LONG}, "step_00/source_filter_teacher/hparams.yaml"),
    "labels": (ON_ESTIMATES | {"labels__members": 96, "schedule__images": 400}, "step_00/reading_errors.json"),
    "adapted teacher": (ON_ESTIMATES | {"teacher__adapt": LONG}, "step_00/teacher/hparams.yaml"),
    "hardened teacher": (ON_ESTIMATES | {"teacher__harden": LONG}, "step_00/hardened_teacher/hparams.yaml"),
}  # fmt: skip
"""What makes a stage long enough to be met in, and the file that tells that it has begun."""


def assert_says_how_to_go_on(folder, code, said, number):
    lines = [line for line in said.splitlines() if "stopped by" in line]
    assert code == CODES[number][0] and "Traceback" not in said and "Error" not in said, said
    assert len(lines) == 1 and said.rstrip().endswith(lines[0]), said
    assert f"stopped by {CODES[number][1]}; finished stages are kept in {folder}, go on with: " in lines[0]
    assert lines[0].endswith(f"idapt fit --config {folder}/config.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("number", CODES, ids=lambda n: n.name)
@pytest.mark.parametrize("stage", STAGES)
def test_a_run_can_be_stopped_in_every_stage(stage, number, tiny_args, tmp_path):
    changes, sign = STAGES[stage]
    folder = tmp_path / "run"
    args = tiny_args(folder, render_processes=1, **changes)
    code, said = stopped(["fit", *args], (folder / sign).exists, [number, number])
    assert_says_how_to_go_on(folder, code, said, number)
    assert not list(folder.rglob("*.tmp"))


def test_sigterm_while_training_is_no_success(tiny_args, tmp_path):
    folder = tmp_path / "run"
    args = tiny_args(folder, schedule__pretrain__state_predictor=LONG)
    begun = (folder / "step_00/state_predictor/hparams.yaml").exists
    code, said = stopped(["fit", *args], begun, [signal.SIGTERM])
    assert_says_how_to_go_on(folder, code, said, signal.SIGTERM)
    assert not (folder / "step_00/state_predictor/final.ckpt").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", CODES, ids=lambda n: n.name)
def test_visual_fit_says_how_to_go_on(number, tmp_path):
    from test_visual import SMALL, squares

    squares(tmp_path / "photos/trainA", 6, (255, 0, 0), 20)
    squares(tmp_path / "photos/trainB", 5, (0, 0, 255), 120)
    folder = tmp_path / "run"
    options = SMALL | {"data.root": tmp_path / "photos", "run_dir": folder, "trainer.max_epochs": 100_000}
    args = [f"--{k}={v}" for k, v in options.items()]
    code, said = stopped(["visual", "fit", *args], (folder / "last.ckpt").exists, [number])
    assert code == CODES[number][0] and "Traceback" not in said
    assert said.splitlines()[-1].endswith(
        f"finished epochs are kept in {folder}, go on with: idapt visual fit --config {folder}/config.yaml"
    )
    assert yaml.safe_load((folder / "config.yaml").read_text())["run_dir"] == str(folder)


@pytest.mark.parametrize("number", CODES, ids=lambda n: n.name)
def test_commands_that_do_not_go_on_say_so(number, monkeypatch, capsys):
    monkeypatch.setattr("cli.report.main", lambda args: signal.raise_signal(number))
    with handlers_put_back():
        assert main(["report", "--run", "x"]) == CODES[number][0]
        ignored = [signal.getsignal(n) for n in CODES]
    assert f"idapt report: stopped by {CODES[number][1]}; nothing was finished" in capsys.readouterr().err
    assert ignored == [signal.SIG_IGN] * 2, "while the program leaves"


def test_a_second_press_is_the_same_press_and_a_later_one_is_not():
    raised = []
    with handlers_put_back(), pytest.raises(Interrupted), interruptible():
        for wait in (0, 0, ONE_PRESS + 0.1):
            time.sleep(wait)
            try:
                signal.raise_signal(signal.SIGINT)
                raised.append(False)
            except Interrupted:
                raised.append(True)
        raise Interrupted(signal.SIGINT)
    assert raised == [True, False, True]


def test_what_was_swallowed_is_raised_again(monkeypatch):
    monkeypatch.setattr("cli.interrupt.SWALLOWED", 0.2)
    with handlers_put_back(), pytest.raises(Interrupted) as raised, interruptible():
        with contextlib.suppress(Interrupted):
            signal.raise_signal(signal.SIGTERM)
        time.sleep(5)
    assert raised.value.exit_code == 143 and signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_handlers_are_put_back_after_a_command(capsys):
    before = [signal.getsignal(n) for n in CODES]
    main(["evaluate", "--run", "none"])
    assert [signal.getsignal(n) for n in CODES] == before


def test_no_signal_leaves_a_lock_taken_or_a_queue_that_counts_wrongly():
    """As the queue to which TensorBoard's thread listens: it is closed when training is interrupted."""
    for delay in np.random.default_rng(0).uniform(0.001, 0.003, 60):
        line = queue.Queue(20)
        reader = threading.Thread(target=read_all, args=(line,), daemon=True)
        reader.start()
        with handlers_put_back(), pytest.raises(Interrupted), interruptible():
            # by another process: a thread of this one would only be heard where the main thread waits
            subprocess.Popen(["sh", "-c", f"sleep {delay}; kill -TERM {os.getpid()}"])
            while True:
                line.put("x")
                sum(range(100))
        line.put(None, timeout=5)
        reader.join(timeout=5)
        assert not reader.is_alive() and line.unfinished_tasks == 1, "all that was put in was read and counted"


def read_all(line):
    while line.get() is not None:
        line.task_done()


def test_a_command_that_waits_for_a_lock_is_stopped():
    held = threading.Condition()
    held.acquire()
    with handlers_put_back(), pytest.raises(Interrupted), interruptible():
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM)).start()
        threading.Condition(held._lock).wait()


STUCK = """
import signal, sys, threading
import cli.main, cli.report
def stuck(args):
    threading.Thread(target=threading.Event().wait).start()
    signal.raise_signal(signal.SIGTERM)
cli.main.LEAVING, cli.report.main, sys.argv = 0.5, stuck, ["idapt", "report", "--run", "x"]
sys.exit(cli.main.main())
"""


def test_a_thread_that_never_ends_does_not_keep_a_stopped_command():
    done = subprocess.run([sys.executable, "-c", STUCK], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 143 and "stopped by SIGTERM" in done.stderr, done.stderr
