"""A run folder is all there is of a run: it may be moved, lose its config, or be used by several commands at once."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from conftest import ROOT

from cli.main import main
from cli.provenance import claim
from cli.run_folder import resumed_in_place
from idapt_pl.files import write_json
from idapt_pl.run import Run
from idapt_pl.run_folder.kept_config import goes_further


@pytest.fixture
def moved(finished_run, tmp_path):
    """A finished run in another place than it was made."""
    return shutil.copytree(finished_run, tmp_path / "elsewhere/moved")


def same_results(a, b):
    names = ("step_02/policy/final.ckpt", "step_02/evaluation.json", "ledger.json")

    def content(run, name):
        data = (run / name).read_bytes()
        if not name.endswith("evaluation.json"):
            return data
        return {k: v for k, v in json.loads(data).items() if k not in ("wall_s", "checksum")}

    return all(content(a, name) == content(b, name) for name in names)


@pytest.mark.parametrize("relative", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_moved_run_folder_resumes_where_it_is(moved, finished_run, relative, monkeypatch):
    (moved / "step_02/evaluation.json").unlink()
    before = {p: p.stat().st_mtime_ns for p in finished_run.rglob("*")}
    monkeypatch.chdir(moved)
    config = Path("config.yaml") if relative else moved / "config.yaml"
    assert main(["fit", "--config", str(config)]) == 0
    assert same_results(moved, finished_run)
    assert {p: p.stat().st_mtime_ns for p in finished_run.rglob("*")} == before, "the old place is left alone"


def test_the_command_that_a_refusal_tells_resumes_the_moved_run(moved, tiny_args, capsys):
    assert main(["fit", *tiny_args(moved, seed=4)]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert (
        f"holds a run with another config (seed differ). Choose another --run_dir, or resume with --config {moved}"
        in told
    )
    assert main(["fit", "--config", str(moved / "config.yaml")]) == 0


def test_a_finished_run_takes_more_grounding_steps_and_no_fewer(moved, finished_run, capsys):
    args = ["fit", "--config", str(moved / "config.yaml"), "--schedule.grounding_steps"]
    assert main([*args, "1"]) == 1
    assert "(schedule.grounding_steps differ)" in " ".join(capsys.readouterr().err.split())
    assert main([*args, "3", "--oracle", "true"]) == 1, "an oracle trains for as long as all policies together"
    assert main([*args, "3"]) == 0
    for name in ("step_01/policy/final.ckpt", "step_02/policy/final.ckpt", "step_02/target.h5"):
        assert (moved / name).read_bytes() == (finished_run / name).read_bytes()
    assert (moved / "step_03/policy/final.ckpt").exists() and (moved / "step_03/evaluation.json").exists()
    before, now = (json.loads((run / "summary.json").read_text()) for run in (finished_run, moved))
    more = yaml.safe_load((moved / "config.yaml").read_text())["schedule"]["interactions"]
    assert now["target_interactions"] == before["target_interactions"] + more
    assert main(["fit", "--config", str(moved / "config.yaml")]) == 0, "it is the run's config now"


@pytest.mark.parametrize(
    ("old", "new", "further"),
    [({}, {}, True), ({"oracle": True}, {}, False), ({}, {"oracle": True}, False), ({}, {"method": "oracle"}, False)],
    ids=["alone", "an oracle before", "an oracle now", "a reference"],
)
def test_nothing_that_trains_as_long_as_all_policies_together_goes_further(old, new, further):
    one, two = ({"schedule": {"grounding_steps": n}} for n in (1, 2))
    assert goes_further(one | old, two | new) is further
    assert not goes_further(two | old, one | new) and not goes_further(one | old, one | new)


def test_run_dir_on_the_command_line_starts_another_run_from_the_same_config(moved, tmp_path):
    config = f"--config={moved / 'config.yaml'}"
    assert resumed_in_place([config]) == [config, f"--run_dir={moved}"]
    assert resumed_in_place([config, "--run_dir", "new"]) == [config, "--run_dir", "new"]
    copy = shutil.copy(moved / "config.yaml", tmp_path)
    assert resumed_in_place(["--config", copy]) == ["--config", copy], "beside it there is no run"


def test_without_its_config_the_folder_takes_no_other_and_gets_it_back(moved, tiny_args, capsys):
    kept = yaml.safe_load((moved / "config.yaml").read_text())
    (moved / "config.yaml").unlink()
    assert main(["fit", *tiny_args(moved, seed=4)]) == 1 and "seed" in capsys.readouterr().err
    (moved / "config.yaml").unlink()
    assert main(["fit", "--config", str(moved / "config.yaml")]) == 0
    assert yaml.safe_load((moved / "config.yaml").read_text()) == kept | {"run_dir": str(moved)}


def test_other_commands_open_a_run_without_its_config(moved, capsys):
    (moved / "config.yaml").unlink()
    assert main(["report", "--run", str(moved)]) == 0 and (moved / "config.yaml").exists()


def test_a_config_that_explodes_is_refused_at_once(tmp_path, capsys):
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
    (tmp_path / "bomb.yaml").write_text(bomb)
    assert main(["fit", "--config", str(tmp_path / "bomb.yaml")]) == 1
    assert "bomb.yaml: not valid YAML: it has more than" in capsys.readouterr().err


def test_what_a_killed_run_left_half_written_is_removed_when_the_folder_is_claimed(moved):
    gone = subprocess.Popen(["true"])
    gone.wait()
    left = [moved / f".run.json.{gone.pid}.tmp", moved / f"step_01/.target.h5.{gone.pid}.tmp"]
    for path in left:
        path.write_text("half")
    writing = moved / f"step_01/.evaluation.json.{os.getppid()}.tmp"
    writing.write_text("of a process that is at work")
    with claim(moved):
        assert not any(path.exists() for path in left) and writing.exists()


def test_of_two_runs_in_one_folder_the_second_is_refused_and_changes_nothing(moved, capsys):
    program = "import sys; from pathlib import Path; from cli.provenance import claim\n"
    program += "with claim(Path(sys.argv[1])): print('at work', flush=True); sys.stdin.readline()"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", program, str(moved)]
    before = (moved / "run.json").read_bytes()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as first:
        assert first.stdout.readline() == "at work\n"
        assert main(["fit", "--config", str(moved / "config.yaml")]) == 1
        assert f"another process is at work in {moved}" in capsys.readouterr().err
        first.communicate("\n")
    assert (moved / "run.json").read_bytes() == before
    assert main(["fit", "--config", str(moved / "config.yaml")]) == 0


def test_evaluating_beside_a_fit_loses_no_entry(moved, capsys):
    """The fit has opened its ledger before the evaluation, and makes an entry after it."""
    fit = Run.open(moved)
    fit.restore_ledger()
    assert main(["evaluate", "--run", str(moved), "--episodes", "1"]) == 0
    fit.worlds.ledger.enter(2, "evaluation", 1000)
    entries = json.loads((moved / "ledger.json").read_text())["entries"]
    assert (2, "evaluation") in [(e["step"], e["purpose"]) for e in entries]
    assert sum("1 episodes, seed 12345" in e["purpose"] for e in entries) == 4


@pytest.mark.slow
def test_evaluations_beside_a_fit_that_is_at_work_lose_no_entry_of_either(tiny_args, tmp_path, capsys):
    run, environment = tmp_path / "run", os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "cli", "fit", *map(str, tiny_args(run, schedule__grounding_steps=3))]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as fit:
        while not (run / "step_00/evaluation.json").exists() and fit.poll() is None:
            time.sleep(0.1)
        beside = 0
        while fit.poll() is None:
            assert main(["evaluate", "--run", str(run), "--episodes", "1", "--seed", str(beside)]) == 0
            beside += 1
    assert fit.returncode == 0 and beside >= 2
    assert main(["ledger", "--run", str(run)]) == 0, capsys.readouterr().err
    purposes = [e["purpose"] for e in json.loads((run / "ledger.json").read_text())["entries"]]
    assert [sum(f"1 episodes, seed {i}" in p for p in purposes) >= 2 for i in range(beside)] == [True] * beside


def test_the_plain_source_lacks_what_was_found_of_its_physics_and_has_its_looks(moved):
    """``idapt evaluate`` measures there what direct transfer transfers."""
    mass = {"effect": "body_mass", "target": "pole", "parameters": {"mass": 150.0}}
    light = {"effect": "light", "target": "headlight", "parameters": {"diffuse": [0.1, 0.1, 0.1]}}
    for name, effect in (("effects", mass), ("looks", light)):
        told = {"step": 0, "stage": name, "wall_s": 1.0, "effects": [effect]}
        write_json(moved / f"step_00/{name}.json", told, checked=True)
    run = Run.open(moved)
    assert [e.name for e in run.worlds.added_effects] == ["light", "body_mass"]
    assert [e.name for e in run.plain_source.effects] == ["camera_pose", "body_mass", "light"], "the task's, and looks"
    plain, repaired = (d.compile().body("pole").mass[0] for d in (run.plain_source, run.worlds.source_domain))
    assert (plain, repaired) == (pytest.approx(4.895), 150.0)
