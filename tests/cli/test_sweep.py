"""``idapt sweep`` from the command line: a real run, what cannot be right, and how it is stopped."""

import json
import shutil
import signal

import psutil
import pytest
import yaml
from conftest import QUICK, TINY
from test_interrupt import LONG, stopped

import cli.sweep
from cli.main import main
from idapt_pl.sweep.folder import WAITING, SweepFolder
from idapt_pl.sweep.settings import read_sweep

NAME = "pendulum_IDAPT_3"


@pytest.fixture
def sweep_yaml(tmp_path):
    """Writes a YAML for tiny runs in ``tmp_path/sweep``."""

    def make(**changes):
        overrides = {key: yaml.safe_load(str(value)) for key, value in TINY.items() if key != "seed"}
        said = {
            "folder": str(tmp_path / "sweep"),
            "tasks": {"pendulum": str(QUICK)},
            "seeds": [3],
            "overrides": overrides,
        }
        said["overrides"] |= changes.pop("overrides", {})
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(said | changes))
        return tmp_path / "s.yaml"

    return make


def test_a_sweep_from_the_yaml_to_the_page(sweep_yaml, finished_run, tmp_path, capsys):
    """Its one run is there already as somebody's run folder: ``idapt fit`` finds every stage done."""
    path, folder = sweep_yaml(), tmp_path / "sweep"
    assert main(["sweep", "--config", str(path), "--dry-run"]) == 0
    assert "1 waiting" in capsys.readouterr().out and not folder.exists(), "a dry run writes nothing"
    shutil.copytree(finished_run, folder / "runs" / NAME)
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("final.ckpt")}
    assert main(["sweep", "--config", str(path)]) == 0, (folder / f"logs/{NAME}.log").read_text()
    assert capsys.readouterr().out.strip() == str(folder / "report.html")
    assert before and all(p.stat().st_mtime_ns == t for p, t in before.items())
    status = json.loads((folder / f"status/{NAME}.json").read_text())
    assert (status["state"], status["failures"]) == ("done", [])
    began = (folder / f"logs/{NAME}.log").stat().st_mtime_ns
    assert main(["sweep", "--folder", str(folder)]) == 0, "the same again, from the folder"
    assert (folder / f"logs/{NAME}.log").stat().st_mtime_ns == began, "what is done is not begun again"
    assert main(["sweep", "--config", str(path), "--index", "0"]) == 0
    capsys.readouterr()
    assert main(["sweep", "status", "--folder", str(folder)]) == 0 and "1 done" in capsys.readouterr().out
    assert main(["sweep", "report", "--folder", str(folder), "--out", str(tmp_path / "p.html")]) == 0
    assert "<b>1 of 1</b>runs done" in (tmp_path / "p.html").read_text()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tasks": ["magic"]}, ["s.yaml: tasks: unknown task 'magic'", "walker2d"]),
        ({"methods": {"m": {"schedule.imagez": 3}}}, ["methods: m, on pendulum", "imagez"]),
        ({"methods": {"m": {"policy.lr": "fast"}}}, ["methods: m, on pendulum", "policy.lr"]),
        ({"methods": {"m": "none.yaml"}}, ["methods: m", "none.yaml"]),
        ({"targets": ["magic"]}, ["methods: IDAPT, on pendulum to magic", "magic", "source, easy, hard"]),
        ({"resources": {"cpus": 999}}, ["resources.cpus is 999"]),
        ({"resources": {"gpus": 64}}, ["resources.gpus is 64"]),
        ({"sedes": [1]}, ["unknown key sedes"]),
    ],
)
def test_what_cannot_be_right_is_said_before_anything_runs(changes, words, sweep_yaml, tmp_path, capsys):
    path = sweep_yaml(**changes)
    assert main(["sweep", "--config", str(path)]) == 1
    said = capsys.readouterr().err
    assert all(word in said for word in words) and "Traceback" not in said and len(said.splitlines()) == 1, said
    assert not (tmp_path / "sweep" / "runs").exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], ["--config"]),
        (["status", "--folder", "."], ["no folder of a sweep", "--config"]),
        (["report", "--folder", "none"], ["none is no folder of a sweep"]),
        (["--config", "none.yaml"], ["none.yaml: No such file"]),
        (["status", "--folder", ".", "--dry-run"], ["--dry-run", "idapt sweep status"]),
        (["--folder", ".", "--index", "0", "--address", "auto"], ["--index", "--address"]),
        (["--folder", ".", "--out", "x.html"], ["--out", "idapt sweep report"]),
    ],
)
def test_arguments_that_say_nothing_are_refused(args, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", *args]) in (1, 2)
    said = capsys.readouterr().err
    assert all(word in said for word in words) and len(said.splitlines()) == 1, said
    assert list(tmp_path.iterdir()) == []


def test_an_index_beyond_the_sweep_is_refused(sweep_yaml, capsys):
    assert main(["sweep", "--config", str(sweep_yaml()), "--index", "1"]) == 1
    assert "--index 1: the sweep has runs 0 to 0" in capsys.readouterr().err


@pytest.mark.slow
def test_sigterm_ends_every_run_and_says_how_to_go_on(sweep_yaml, tmp_path):
    path = sweep_yaml(overrides={"schedule.pretrain.state_predictor": LONG})
    folder = SweepFolder(tmp_path / "sweep")
    begun = (folder.run(NAME) / "step_00/state_predictor/hparams.yaml").exists
    code, said = stopped(["sweep", "--config", path], begun, [signal.SIGTERM], within=300)
    last = said.splitlines()[-1]
    assert (
        code == 143 and "Traceback" not in said and last.startswith("idapt sweep: stopped by SIGTERM; finished stages")
    )
    assert last.endswith(f"go on with: idapt sweep --folder {folder.path}")
    assert folder.status(NAME).state == WAITING and folder.status(NAME).failures == []
    assert "idapt fit: stopped by SIGTERM" in folder.log(NAME).read_text()
    left = [p for p in psutil.process_iter(["cmdline"]) if any(str(folder.path) in a for a in p.info["cmdline"] or [])]
    assert left == []


def test_status_follows_the_yaml_and_falls_back_to_the_plan(sweep_yaml, monkeypatch):
    """Runs that jobs of an array made after a plan was kept are there too."""
    monkeypatch.setattr(
        cli.sweep, "complete_config", lambda arguments: {"task": "pendulum", "target": "hard", "seed": 0}
    )
    settings = read_sweep(sweep_yaml())
    folder = SweepFolder(settings.folder)
    kept = cli.sweep.plan_sweep(settings, folder, cli.sweep.complete_config)
    more = read_sweep(sweep_yaml(seeds=[3, 4]))
    assert [run.seed for run in cli.sweep.planned_now(more, folder)] == [3, 4]
    assert folder.read_plan() == kept, "looking writes nothing"
    gone = read_sweep(sweep_yaml(tasks={"pendulum": "gone.yaml"}))
    assert cli.sweep.planned_now(gone, folder) == kept
    with pytest.raises(ValueError, match=r"gone\.yaml"):
        cli.sweep.planned_now(gone, SweepFolder(folder.path / "other"))
