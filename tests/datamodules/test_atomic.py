"""Files are written whole or not at all, also where the disk is full or a process was killed."""

import os
import subprocess
import sys

import pytest
from conftest import ROOT

from datamodules.atomic import remove_stale, write_atomically, write_bytes


@pytest.fixture
def dead():
    """The number of a process that is gone."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def test_an_error_while_writing_leaves_the_file_as_it_was_and_names_it(tmp_path):
    path = tmp_path / "d.txt"
    path.write_text("before")

    def fail(temporary):
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=r"could not write .*d\.txt: No space left on device.*Free some space"):
        write_atomically(path, fail)
    assert path.read_text() == "before" and os.listdir(tmp_path) == ["d.txt"]


def test_a_folder_that_is_a_file_is_an_error_that_names_what_was_to_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"could not write .*file/d\.txt"):
        write_bytes(tmp_path / "file" / "d.txt", b"")


def test_remains_of_killed_processes_are_removed_and_nothing_else(tmp_path, dead):
    living = os.getppid()
    for name in (
        f".d.h5.{dead}.tmp",
        f".e.h5.{dead}.tmp",
        f".d.h5.{living}.tmp",
        "d.h5",
        ".d.h5.tmp",
        f"d.h5.{dead}.tmp",
    ):
        (tmp_path / name).write_text("")
    (tmp_path / "step_00").mkdir()
    (tmp_path / f"step_00/.d.h5.{dead}.tmp").write_text("")
    assert [p.name for p in remove_stale(tmp_path / "d.h5")] == [f".d.h5.{dead}.tmp"]
    assert {p.name for p in remove_stale(tmp_path)} == {f".e.h5.{dead}.tmp", f".d.h5.{dead}.tmp"}
    left = {p.name for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {f".d.h5.{living}.tmp", "d.h5", ".d.h5.tmp", f"d.h5.{dead}.tmp"}


def test_a_number_of_our_own_is_of_a_process_that_is_gone(tmp_path):
    """A container starts counting anew."""
    (tmp_path / f".d.h5.{os.getpid()}.tmp").write_text("")
    assert len(remove_stale(tmp_path)) == 1 and list(tmp_path.iterdir()) == []


FULL_DISK = """
import os, resource, sys
from pathlib import Path
import numpy as np, torch
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.checkpoints import checkpoint_bytes
from idapt_pl.files import write_bytes, write_json

class Module(torch.nn.Module):
    hparams = {}
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(300, 300)

pixels = np.random.default_rng(0).integers(0, 256, (41, 50, 50, 3), np.uint8)  # noise: gzip does not help
data = Trajectories((Episode(np.zeros((40, 1), np.float32), {"pixels": pixels}),), 0.04)
writers = {
    "d.h5": lambda path: write_trajectories(path, data),
    "final.ckpt": lambda path: write_bytes(path, checkpoint_bytes(Module())),
    "r.json": lambda path: write_json(path, {"values": list(range(60_000))}, checked=True),
}
for name, write in writers.items():
    folder = Path(sys.argv[1]) / name.replace(".", "_")
    write(folder / name)
    before = (folder / name).read_bytes()
    for share in (0, 0.001, 0.01, 0.1, 0.25, 0.5, 0.7, 0.9, 0.99, 0.9999):
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * len(before)), resource.RLIM_INFINITY))
        try:
            write(folder / name)
        except OSError as error:
            told = str(error)
        else:
            told = "was written"
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        assert told.startswith(f"could not write {folder / name}: File too large"), (name, share, told)
        assert os.listdir(folder) == [name] and (folder / name).read_bytes() == before, (name, share)
    write(folder / name)
print("whole")
"""


def test_a_full_disk_is_one_plain_error_whatever_is_written_and_wherever_it_fills(tmp_path):
    """A limit on the size of files stands for the disk; in a process of its own, since HDF5 used to crash there."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "whole"), done.stderr[-2000:]
