"""Runs side by side, in processes: as many as there are cores, tried again when they fail, ended with their starter.

In place of ``idapt fit`` runs a program of a few lines that does as its config says.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import psutil
import pytest
import yaml
from conftest import ROOT

from idapt_pl.sweep.child import Attempt
from idapt_pl.sweep.folder import BY_HAND, DONE, FAILED, RUNNING, WAITING, RunStatus, SweepFolder, last_stage
from idapt_pl.sweep.runner import LocalRunner, local_slots
from idapt_pl.sweep.settings import RunResources
from idapt_pl.sweep.work import SweepWorker, alone

PROGRAM = """
import json, os, sys, time
from pathlib import Path
options = dict(a[2:].split("=", 1) for a in sys.argv[1:])
run, config = Path(options["run_dir"]), json.loads(Path(options["config"]).read_text())
run.mkdir(parents=True, exist_ok=True)
calls = run / "calls.txt"
calls.open("a").write(f"{time.time()} {os.environ.get('CUDA_VISIBLE_DEVICES')} {sorted(options)}\\n")
print("attempt", len(calls.read_text().splitlines()), flush=True)
(run / "pid").write_text(str(os.getpid()))
time.sleep(config.get("seconds", 0))
codes = config.get("codes", [0])
code = codes[min(len(calls.read_text().splitlines()), len(codes)) - 1]
if code == 0:
    (run / "summary.json").write_text("{}")
(run / "ended").write_text(str(time.time()))
sys.exit(code)
"""


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    """A folder with configs for the program above, and a worker for it."""
    (tmp_path / "pretended_fit.py").write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    folder = SweepFolder(tmp_path / "sweep")
    (folder.path / "configs").mkdir(parents=True)

    def make(retries=1, **configs):
        for name, config in configs.items():
            folder.config(name).write_text(json.dumps(config))  # which is YAML too
        return SweepWorker(folder, RunResources(), retries, program=("pretended_fit",))

    return make


def calls(worker, name):
    return (worker.folder.run(name) / "calls.txt").read_text().splitlines()


def until(true, seconds=30.0):
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.02)
    assert true()


def test_as_many_runs_go_side_by_side_as_there_are_slots(sweep):
    worker = sweep(**{f"r{i}": {"seconds": 0.6} for i in range(5)})
    ticks = []
    LocalRunner(worker, ["", ""]).run([f"r{i}" for i in range(5)], lambda: ticks.append(1))
    spans = []
    for i in range(5):
        assert worker.folder.status(f"r{i}").state == DONE and len(calls(worker, f"r{i}")) == 1
        spans.append(
            (float(calls(worker, f"r{i}")[0].split()[0]), float((worker.folder.run(f"r{i}") / "ended").read_text()))
        )
    at_once = [sum(a <= begin < b for a, b in spans) for begin, _ in spans]
    assert max(at_once) == 2 and ticks


def test_what_failed_is_tried_again_a_limited_number_of_times(sweep):
    worker = sweep(retries=2, once={"codes": [1, 0]}, ever={"codes": [1]}, wrong={"codes": [2]}, asks={"codes": [3]})
    LocalRunner(worker, [""]).run(["once", "ever", "wrong", "asks"], lambda: None)
    status = {name: worker.folder.status(name) for name in ("once", "ever", "wrong", "asks")}
    assert [s.state for s in status.values()] == [DONE, FAILED, FAILED, BY_HAND]
    assert [len(calls(worker, n)) for n in status] == [2, 3, 1, 1]
    assert [f["code"] for f in status["ever"].failures] == [1, 1, 1] and status["ever"].failures[-1]["lines"] == [
        "attempt 3"
    ]
    assert "attempt 1\nattempt 2\nattempt 3" in worker.folder.log("ever").read_text()
    LocalRunner(worker, [""]).run(list(status), lambda: None)  # the same command again
    assert [len(calls(worker, n)) for n in status] == [2, 3, 1, 2], "who waits for recordings is asked again"
    worker.folder.forget_failures("ever")
    LocalRunner(worker, [""]).run(["ever"], lambda: None)
    assert len(calls(worker, "ever")) == 6, "--retry"


@pytest.mark.parametrize("code", [-signal.SIGKILL, 143])
def test_a_run_that_is_killed_has_failed_and_one_that_a_scheduler_stops_waits(code, sweep):
    worker = sweep(r={"seconds": 0 if code > 0 else 60, "codes": [code]})
    if code < 0:

        def kill():
            until((worker.folder.run("r") / "pid").exists)
            time.sleep(0.1)
            os.kill(int((worker.folder.run("r") / "pid").read_text()), signal.SIGKILL)

        threading.Thread(target=kill).start()
    status = SweepWorker(worker.folder, worker.resources, 0, program=worker.program).carry_out("r")
    assert status.state == (FAILED if code < 0 else WAITING) and len(status.failures) == (code < 0)


def test_stopping_ends_what_runs_and_counts_no_failure(sweep):
    worker = sweep(r={"seconds": 60}, later={})
    runner = LocalRunner(worker, [""])

    def stop():
        until((worker.folder.run("r") / "pid").exists)
        assert worker.folder.status("r").state == RUNNING
        runner.stop()

    stopper = threading.Thread(target=stop)
    stopper.start()
    runner.run(["r", "later"], lambda: None)
    stopper.join()
    assert not psutil.pid_exists(int((worker.folder.run("r") / "pid").read_text()))
    assert worker.folder.status("r") == RunStatus(WAITING, [], worker.folder.status("r").host)
    assert not worker.folder.run("later").exists()


CARRIES_OUT = """
import sys
from pathlib import Path
from idapt_pl.sweep.folder import SweepFolder
from idapt_pl.sweep.settings import RunResources
from idapt_pl.sweep.work import SweepWorker
SweepWorker(SweepFolder(Path(sys.argv[1])), RunResources(), 0, program=("pretended_fit",)).carry_out("r")
"""


def test_a_killed_sweep_leaves_no_run_behind_and_goes_on(sweep):
    worker = sweep(r={"seconds": 60})
    path = os.pathsep.join((str(ROOT), os.environ["PYTHONPATH"]))
    env = os.environ | {"PYTHONPATH": path}
    process = subprocess.Popen([sys.executable, "-c", CARRIES_OUT, str(worker.folder.path)], env=env)
    pid = worker.folder.run("r") / "pid"
    until(lambda: pid.exists() and pid.read_text() != "", 240)
    child = psutil.Process(int(pid.read_text()))
    assert worker.folder.status("r").state == RUNNING
    assert worker.carry_out("r").host == "another process", "what somebody has in work is left to him"
    process.kill()
    process.wait()
    assert psutil.wait_procs([child], timeout=10)[1] == []
    assert worker.folder.status("r").state == WAITING
    sweep(r={})
    assert worker.carry_out("r").state == DONE and len(calls(worker, "r")) == 2


def test_errors_of_this_machine_are_told_when_the_others_have_ended(sweep):
    worker = sweep(r={}, s={})
    worker.folder.status_file("r").mkdir(parents=True)  # cannot be read or written
    with pytest.raises(ValueError, match=r"r\.json: cannot be used"):
        LocalRunner(worker, ["", ""]).run(["r", "s"], lambda: None)
    assert worker.folder.status("s").state == DONE


def test_each_run_gets_its_cores_and_cards():
    assert local_slots(RunResources(2), 5, []) == ["", ""]
    assert local_slots(RunResources(1, 1), 8, ["0", "1"]) == ["0", "1"]
    assert local_slots(RunResources(1, 0.5), 8, ["0", "1"]) == ["0", "1", "0", "1"]
    assert local_slots(RunResources(3, 0.5), 8, ["0", "1"]) == ["0", "1"]
    assert local_slots(RunResources(1, 2), 8, ["0", "1", "2", "3", "4"]) == ["0,1", "2,3"]
    with pytest.raises(ValueError, match=r"resources.cpus is 3, but this machine has 2"):
        local_slots(RunResources(3), 2, [])
    with pytest.raises(ValueError, match=r"resources.gpus is 1, but this machine has 0"):
        local_slots(RunResources(1, 1), 2, [])


def test_a_run_keeps_to_its_cores_unless_its_config_says_otherwise():
    assert alone({}, RunResources(2)) == ["--threads=2", "--side_by_side=false", "--render_processes=1"]
    assert alone({"threads": 4, "side_by_side": True, "render_processes": 0}, RunResources(2)) == []


def test_cards_reach_the_run(sweep):
    worker = sweep(r={}, s={})
    worker.carry_out("r", devices="1")
    worker.carry_out("s", devices="")
    assert calls(worker, "r")[0].split()[1] == "1" and calls(worker, "s")[0].split(" ")[1] == ""
    assert "'config', 'render_processes', 'run_dir', 'side_by_side', 'threads'" in calls(worker, "r")[0]


def test_only_what_this_attempt_said_is_told(tmp_path):
    log = tmp_path / "logs" / "r.log"
    for said in ("first", "second"):
        with Attempt(("this",), log, 1) as attempt:
            attempt.process.wait()
            lines = attempt.last_lines()
        assert any("zen" in line.lower() or "." in line for line in lines), said
    assert log.read_text().count("Beautiful is better than ugly") == 2 and len(lines) == 6


def test_what_a_run_finished_last_is_known(tmp_path):
    assert last_stage(tmp_path) == ""
    for i, name in enumerate(("step_00/state_predictor/stage.json", "step_00/looks.json", "step_01/visual/stage.json")):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump({}))
        os.utime(path, (i, i))
    assert last_stage(tmp_path) == "step 1 visual"
