"""JSON results of grounding steps: ``RUN/step_<k>/<name>.json`` says of itself which step and stage it is of."""

from __future__ import annotations

from pathlib import Path

from idapt_pl.files import REDO, DamagedFile, read_json

UNCUT = "uncut_"
"""Before the names of what step 0 made of exploring episodes before they were cut (docs/decisions/078)."""
REPAIRED = "repaired_"
"""Before the names of what step 0 learned from the repaired source's exploration (docs/decisions/083)."""


def read_result(path: Path) -> dict:
    """Read the result of a stage.

    Raises:
        DamagedFile: if it is missing or damaged, or the result of another stage or step.
    """
    result = read_json(path, ("step", "stage", "wall_s"))
    if not belongs(path, result):
        raise DamagedFile(f"{path}: holds {result['stage']} of step {result['step']}. {REDO}")
    return result


def newest_of(folder: Path, name: str) -> Path:
    """A file of a grounding step, ``RUN/step_<k>``: as it was made again from the repaired source, if it was."""
    again = folder / f"{REPAIRED}{name}"
    return again if again.exists() else folder / name


def effect_files(folder: Path) -> list[Path]:
    """The results that say which effects a grounding step, ``RUN/step_<k>``, added to the source.

    Those of its pictures, then those of its physics: of the search from known starts, if there was one.
    """
    physical = [folder / f"{name}.json" for name in ("known_start_search", "effects")]
    last = [path for path in physical if path.exists()][:1]
    return [path for path in (folder / "looks.json", *last) if path.exists()]


def belongs(path: Path, result: dict) -> bool:
    """Whether a result, as far as it says what it is, is that which a file should hold."""
    stage = path.parent.name if path.name == "stage.json" else path.stem
    folder = path.parent.parent if path.name == "stage.json" else path.parent
    told = result.get("step"), result.get("stage")
    return told[0] in (None, step_of(folder)) and told[1] in (None, stage)


def step_of(folder: Path) -> int | None:
    """The grounding step whose folder this is; None if it is no step's."""
    number = folder.name.removeprefix("step_")
    return int(number) if number != folder.name and number.isdecimal() else None
