"""The linters find nothing: `make lint` runs the same."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LINTERS = {
    "ruff check .": "what `ruff check --fix .` does not mend is to be mended by hand",
    "ruff format --check .": "run `ruff format .`",
    "mypy": "annotate, or mend; settings are in pyproject.toml",
}
"""Command to what helps."""


def complaints(command: str, folder: Path) -> str:
    """What a linter says about a folder; empty where it finds nothing. One that cannot be run is an error too."""
    done = subprocess.run([sys.executable, "-m", *command.split()], cwd=folder, capture_output=True, text=True)
    return done.stdout + done.stderr if done.returncode else ""


@pytest.mark.parametrize("command", LINTERS)
def test_linters_find_nothing(command):
    said = complaints(command, ROOT)
    assert not said, f"`{command}` (or `make lint`) finds faults; {LINTERS[command]}:\n{said}"


@pytest.mark.parametrize("command", LINTERS)
def test_make_lint_runs_them(command):
    assert f"$(BIN)/{command}\n" in (ROOT / "Makefile").read_text()


@pytest.mark.parametrize(
    ("command", "text", "told"),
    [
        ("ruff check .", '"""Doc."""\n\nimport os\n', "F401"),
        ("ruff format --check .", "x = [ 1]\n", "--> idapt_pl/bad.py:1"),
        ("mypy", "def f(x):\n    return x\n", "idapt_pl/bad.py:1: error: Function is missing a type annotation"),
    ],
)
def test_planted_faults_are_found(tmp_path, command, text, told):
    for package in ("idapt_pl", "datamodules", "cli"):
        (tmp_path / package).mkdir()  # those that mypy is told to check
        (tmp_path / package / "__init__.py").write_text('"""A package."""\n')
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    assert complaints(command, tmp_path) == ""
    (tmp_path / "idapt_pl" / "bad.py").write_text(text)
    assert told in complaints(command, tmp_path)


@pytest.mark.slow
def test_benchmarks_call_what_there_is():
    """Scripts that nobody runs for weeks notice by this that what they call has changed."""
    command = "mypy -p benchmarks --namespace-packages --explicit-package-bases"
    done = subprocess.run([sys.executable, "-m", *command.split()], cwd=ROOT, capture_output=True, text=True)
    assert "checked" in done.stdout, done.stdout + done.stderr
    kinds = ("[call-arg]", "[attr-defined]", "[name-defined]")
    assert not [line for line in done.stdout.splitlines() if line.endswith(kinds)]
