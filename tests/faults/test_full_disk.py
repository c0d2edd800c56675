"""A disk that fills up in the middle of a run: one line, nothing half written, and the same command goes on."""

import os
import resource
import subprocess
import sys

import pytest
from conftest import ROOT

LARGEST = (3_000, 40_000, 150_000)
"""Bytes that a file may have before the system refuses more of it: fits JSON, and recordings, and small networks."""


def fit(args, largest=None):
    """``idapt fit`` in a process whose files may not become larger. Returns exit code and stderr."""

    def limited():
        if largest is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    done = subprocess.run(
        [sys.executable, "-m", "cli", "fit", *args], cwd=ROOT, preexec_fn=limited, text=True, timeout=300,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=os.environ | {"IDAPT_RENDERER": "classic"},
    )  # fmt: skip
    return done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("largest", LARGEST)
def test_a_run_whose_disk_is_full_says_so_and_goes_on_when_there_is_room(largest, tiny_args, tmp_path):
    args = tiny_args(tmp_path / "run", schedule__grounding_steps=1, threads=1, side_by_side="false")
    code, said = fit(args, largest)
    lines = [line for line in said.splitlines() if line.startswith("idapt ")]
    assert code == 1 and len(lines) == 1 and "Traceback" not in said, said
    assert "File too large" in lines[0] or "could not be written" in lines[0], said
    assert not list((tmp_path / "run").rglob("*.tmp"))
    code, said = fit(args)
    assert code == 0, said
    assert (tmp_path / "run/summary.json").exists() and not list((tmp_path / "run").rglob("*.tmp"))
