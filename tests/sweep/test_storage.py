"""Runs kept in a storage: whole files, those that changed, none that are gone."""

from dataclasses import replace

import pytest

pytest.importorskip("pyarrow")

from idapt_pl.sweep.folder import DONE, RUNNING, WAITING, RunStatus, SweepFolder
from idapt_pl.sweep.ray_runner import carry_out_in_a_copy, scratch_of
from idapt_pl.sweep.settings import RunResources
from idapt_pl.sweep.storage import RunStorage, parts_of
from idapt_pl.sweep.work import SweepWorker

PROGRAM = """
import sys, time
from pathlib import Path
run = Path(dict(a[2:].split("=", 1) for a in sys.argv[1:])["run_dir"])
for stage in ("visual", "policy"):
    folder = run / "step_00" / stage
    if (folder / "final.ckpt").exists():
        continue
    folder.mkdir(parents=True)
    (run / f"did_{stage}").write_text(str(time.time()))
    (folder / "stage.json").write_text("{}")
    (folder / "final.ckpt").write_text("x")
    time.sleep(3)
    if stage == "visual" and (run / "stop_after_visual").exists():
        sys.exit(143)
(run / "summary.json").write_text("{}")
"""
"""Two stages, each skipped if it was done."""


def write(path, text="x"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_what_changed_is_copied_and_what_is_gone_is_removed(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    storage = RunStorage(str(tmp_path / "storage"))
    write(here / "runs/r/step_00/visual/final.ckpt", "weights")
    write(here / "runs/r/.final.ckpt.12.tmp")
    write(here / "status/r.json", "{}")
    assert storage.put(here, parts_of("r")) == 2 and storage.put(here, parts_of("r")) == 0
    write(here / "runs/r/step_00/visual/final.ckpt", "other weights")
    write(here / "runs/r/target_parts/0.h5")
    assert storage.put(here, parts_of("r")) == 2
    (here / "runs/r/target_parts/0.h5").unlink()
    assert storage.put(here, parts_of("r")) == 0
    write(there / "runs/r/old.json")
    fresh = RunStorage(str(tmp_path / "storage"))
    assert fresh.has("runs/r") and not fresh.has("runs/s")
    fresh.get(there, parts_of("r"))
    files = sorted(str(p.relative_to(there)) for p in there.rglob("*") if p.is_file())
    assert files == ["runs/r/step_00/visual/final.ckpt", "status/r.json"]
    assert (there / "runs/r/step_00/visual/final.ckpt").read_text() == "other weights"
    assert fresh.put(there, parts_of("r")) == 0, "what was fetched is not sent back"


def test_a_storage_that_cannot_be_is_said(tmp_path):
    write(tmp_path / "file")
    for address in (str(tmp_path / "file"), "magic://bucket/x"):
        with pytest.raises(ValueError, match=f"storage {address}: cannot be opened"):
            RunStorage(address)


def test_a_run_goes_on_elsewhere_from_its_last_stage(tmp_path, monkeypatch):
    """Two folders stand for two machines; the first is left in the middle of the second stage, as it were."""
    write(tmp_path / "two_stages.py", PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    storage, main = RunStorage(str(tmp_path / "storage")), SweepFolder(tmp_path / "main")
    main.write_config("r", {})
    write(main.run("r") / "stop_after_visual")
    storage.put(main.path, ("configs/r.yaml", *parts_of("r")))
    first, second = SweepFolder(tmp_path / "first"), SweepFolder(tmp_path / "second")
    worker = SweepWorker(main, RunResources(), 0, program=("two_stages",))
    status = carry_out_in_a_copy(RunStorage(str(tmp_path / "storage")), first, worker, "r", "")
    assert status.state == WAITING and storage.has("runs/r/step_00/visual")
    write(first.run("r") / "step_00/policy/half", "never copied")  # lost with its machine
    storage.put(main.path, parts_of("nothing"))
    storage._files.delete_file(storage._path("runs/r/stop_after_visual"))
    status = carry_out_in_a_copy(RunStorage(str(tmp_path / "storage")), second, worker, "r", "")
    assert status.state == DONE
    storage.get(main.path, parts_of("r"))
    did = (main.run("r") / "did_visual").read_text()
    assert did == (first.run("r") / "did_visual").read_text(), "the first stage was done once"
    assert main.status("r").state == DONE and not (main.run("r") / "step_00/policy/half").exists()


def test_a_predecessor_that_has_not_left_yet_is_waited_for(tmp_path):
    folder = SweepFolder(tmp_path / "scratch")
    worker = replace(SweepWorker(folder, RunResources(), 0))
    with folder.lock("r.copy").acquire():
        status = carry_out_in_a_copy(RunStorage(str(tmp_path / "storage")), folder, worker, "r", "")
    assert status == RunStatus(RUNNING, [], "another process")


def test_each_storage_has_its_own_place_on_a_machine():
    assert scratch_of("s3://a/b") == scratch_of("s3://a/b") != scratch_of("s3://a/c")
