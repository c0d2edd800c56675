"""Damage to any file of a run is named or made good again: never a traceback, never another result."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from idapt_pl.run_folder.interactions import VIDEO_STEPS

FILES = {
    "config.yaml": "run.json",
    "run.json": "ledger.json",
    "ledger.json": "run.json",
    "summary.json": "run.json",
    "evaluation_1_5.json": "step_00/evaluation.json",
    "step_00/direct_transfer.json": "step_00/evaluation.json",
    "step_01/evaluation.json": "step_02/evaluation.json",
    "step_01/target.json": "step_01/source.json",
    "step_01/policy/stage.json": "step_02/policy/stage.json",
    "step_00/visual/final.ckpt": "step_01/visual/final.ckpt",
    "step_01/policy/final.ckpt": "step_02/policy/final.ckpt",
    "step_02/dynamics/final.ckpt": "step_02/policy/final.ckpt",
    "step_01/target.h5": "step_02/target.h5",
    "step_00/source.h5": "step_00/target.h5",
    "step_02/translated.h5": "step_02/source.h5",
    "step_01/policy/metrics.csv": "config.yaml",
    "step_01/policy_in_grounded_and_target.gif": "report.html",
}
"""A file of each kind that a run has, and another that it is replaced by."""


def changed(start: float, length: int) -> Callable[[bytes], bytes]:
    """Some bytes changed, from a share of the file on."""

    def change(whole: bytes) -> bytes:
        first = min(int(start * len(whole)), max(0, len(whole) - length))
        part = whole[first : first + length]
        return whole[:first] + bytes(b ^ 0x15 for b in part) + whole[first + len(part) :]

    return change


DAMAGES: dict[str, Callable[[bytes], bytes] | None] = {
    "64 bytes changed": changed(0.5, 64),
    "a byte changed": changed(0.31, 1),
    "the end changed": changed(0.97, 3),
    "half": lambda whole: whole[: len(whole) // 2],
    "without its last byte": lambda whole: whole[:-1],
    "emptied": lambda whole: b"",
    "no text": lambda whole: bytes(range(256)),
    "deleted": None,
    "replaced": None,
}

CASES = [(file, damage) for file in FILES for damage in DAMAGES]
SAMPLE = CASES[3::16]


def damage(run: Path, file: str, how: str) -> None:
    path = run / file
    if how == "deleted":
        path.unlink()
    elif how == "replaced":
        shutil.copyfile(run / FILES[file], path)
    else:
        path.write_bytes(DAMAGES[how](path.read_bytes()))


@pytest.fixture(scope="module")
def whole_run(finished_run, tmp_path_factory):
    """A finished run that was also evaluated later."""
    run = shutil.copytree(finished_run, tmp_path_factory.mktemp("whole") / "run")
    assert main(["evaluate", "--run", str(run), "--episodes", "1", "--seed", "5"]) == 0
    return run


def results(run: Path) -> dict:
    """All that a run is for, but for how long it took."""
    found: dict = {str(p.relative_to(run)): p.read_bytes() for p in run.rglob("final.ckpt")}
    for p in [*run.glob("step_*/evaluation.json"), run / "step_00/direct_transfer.json", run / "ledger.json"]:
        content = json.loads(p.read_text())
        found[str(p.relative_to(run))] = {k: v for k, v in content.items() if k not in ("wall_s", "checksum")}
    # what `idapt evaluate` found to measure, while a policy was lost, is another thing
    found["ledger.json"]["entries"] = [e for e in found["ledger.json"]["entries"] if e["step"] >= 0]
    return found


def assert_named_or_made_good(whole: Path, folder: Path, file: str, how: str, capsys) -> None:
    """Every command ends well, or with a line or two that name the file; a fit that ends well has the same results."""
    run = shutil.copytree(whole, folder / "run")
    damage(run, file, how)
    for command in (["report"], ["ledger"], ["evaluate", "--episodes", "1", "--seed", "5"]):
        check([*command, "--run", str(run)], file, capsys)
    if check(["fit", "--config", str(run / "config.yaml")], file, capsys) == 0:
        assert results(run) == results(whole)


def check(command: list[str], file: str, capsys) -> int:
    capsys.readouterr()
    code = main(command)  # any exception is a traceback
    told = capsys.readouterr().err
    if code:
        error = [line for line in told.splitlines() if line.startswith(("idapt", "/", "step"))]
        most = 2 if command[0] != "ledger" else 6  # a line for each entry that disagrees
        assert 1 <= len(error) <= most and "Traceback" not in told and len(" ".join(error)) < 1200, told
        named = Path(file).name in told or "no file holds them" in told
        assert named, f"{command[0]}: {file} is not named: {told}"
    return code


@pytest.mark.parametrize(("file", "how"), SAMPLE, ids=lambda value: value.replace("/", "-"))
def test_damage_is_named_or_made_good(whole_run, tmp_path, file, how, capsys):
    assert_named_or_made_good(whole_run, tmp_path, file, how, capsys)


@pytest.mark.slow
@pytest.mark.parametrize(("file", "how"), CASES, ids=lambda value: value.replace("/", "-"))
def test_all_damages_are_named_or_made_good(whole_run, tmp_path, file, how, capsys):
    assert_named_or_made_good(whole_run, tmp_path, file, how, capsys)


def test_a_run_of_a_version_without_checksums_is_resumed_as_it_is(whole_run, tmp_path):
    run = shutil.copytree(whole_run, tmp_path / "run")
    for path in run.rglob("*.json"):
        content = {k: v for k, v in json.loads(path.read_text()).items() if k not in ("checksum", "sha256", "config")}
        path.write_text(json.dumps(content))
    for path in run.glob("step_*/evaluation.json"):  # nor did it count the video
        content = json.loads(path.read_text())
        del content["video_interactions"]
        path.write_text(json.dumps(content))
    ledger = json.loads((run / "ledger.json").read_text())
    for entry in ledger["entries"]:
        entry["count"] -= VIDEO_STEPS * (entry["purpose"] == "evaluation")
    (run / "ledger.json").write_text(json.dumps(ledger))
    assert main(["fit", "--config", str(run / "config.yaml")]) == 0
    assert (run / "ledger.json").read_bytes() == (whole_run / "ledger.json").read_bytes()
    assert main(["report", "--run", str(run)]) == 0


def test_there_are_many_damages():
    assert len(CASES) >= 60 and 8 <= len(SAMPLE) <= 12
    assert len({file for file, _ in SAMPLE}) >= 8 and len({how for _, how in SAMPLE}) >= 6


@pytest.mark.slow
def test_a_changed_byte_anywhere_in_the_config_is_named_or_changes_nothing(whole_run, tmp_path, capsys):
    size = (whole_run / "config.yaml").stat().st_size
    for start in np.linspace(0, size - 1, 12).astype(int):
        run = shutil.copytree(whole_run, tmp_path / str(start))
        path = run / "config.yaml"
        path.write_bytes(changed(start / size, 1)(path.read_bytes()))
        if check(["fit", "--config", str(path)], "config.yaml", capsys) == 0:
            assert results(run) == results(whole_run)
