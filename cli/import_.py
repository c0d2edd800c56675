"""``idapt import``: recordings (CSV, NPZ, Minari, LeRobot, MCAP) as a trajectory file; see docs/guide/import.md."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm

from cli.arguments import keep_inputs, parser, show_bar
from datamodules import write_trajectories
from datamodules.recordings import (
    FORMATS,
    ActuatorLayout,
    Imported,
    JointLayout,
    Mapping,
    ModelLayout,
    RecordingError,
    convert,
    fit_to_model,
    read_mapping,
    read_recording,
    summary,
)
from datamodules.recordings.check import check_against_model, check_velocities

JOINT_TYPES = ("free", "ball", "slide", "hinge")
"""By MuJoCo's number for them (mjtJoint)."""


def main(args: list[str]) -> int:
    """Run ``idapt import``.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    p = parser("import", __doc__)
    p.add_argument("recordings", nargs="+", metavar="RECORDING", help="file, dataset folder or Minari dataset id")
    p.add_argument("--map", type=Path, required=True, help="YAML: which column is which joint, actuator and time")
    p.add_argument("--model", type=Path, help="MJCF that the recording is checked against and ordered as")
    p.add_argument("--out", type=Path, help="trajectory file to write (HDF5); not needed with --dry-run")
    p.add_argument("--format", choices=FORMATS, help="default: told by the recording's name")
    p.add_argument("--dry-run", action="store_true", help="show what was understood and write nothing")
    o = p.parse_args(args)
    if o.out is None and not o.dry_run:
        p.error("--out is required, or --dry-run to write nothing")
    if o.out is not None:
        keep_inputs(o.out, [*o.recordings, o.map, o.model])
    mapping, layout = read_mapping(o.map), None
    if o.model is not None:
        layout = read_layout(o.model)
        mapping = fit_to_model(mapping, layout)
    imported = import_recordings(o.recordings, mapping, layout, o.format)
    print_preview(imported, mapping)
    if o.dry_run:
        print("dry run: nothing was written")
        return 0
    write_trajectories(o.out, imported.trajectories)
    print(f"{o.out}: {len(imported.trajectories)} episodes, {imported.trajectories.total_steps} steps")
    return 0


def import_recordings(
    paths: list[str], mapping: Mapping, layout: ModelLayout | None = None, format: str | None = None
) -> Imported:
    """Read, convert and check recordings.

    Args:
        paths: files, folders or Minari ids.
        mapping: which column is what, already in the model's order.
        layout: of the model that they are checked against, or None.
        format: of the recordings; None: told by their names.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    recorded = []
    for path in tqdm(paths, unit="file", leave=False, disable=len(paths) < 2 or not show_bar()):
        recorded += read_recording(path, mapping, format)
    names = [Path(path).name for path in paths]
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    imported = convert(recorded, mapping, f"idapt import: {', '.join(names[:5])}{more}")
    notes = check_velocities(imported, mapping)
    if layout is not None:
        notes += check_against_model(imported, layout)
    return replace(imported, notes=imported.notes + notes)


def read_layout(path: Path) -> ModelLayout:
    """Names, types and ranges of a model's joints and actuators.

    What has no name goes by its number, ``joint0`` and ``actuator0``; an actuator rather by its joint's name.

    Raises:
        RecordingError: if the model cannot be read.
    """
    from idapt_pl.diagnosis.model import read_model

    try:
        model = read_model(path).compile()
    except ValueError as error:
        raise RecordingError(str(error)) from None
    joints = tuple(
        JointLayout(
            model.joint(i).name,
            JOINT_TYPES[model.jnt_type[i]],
            tuple(model.jnt_range[i]) if model.jnt_limited[i] else None,
        )
        for i in range(model.njnt)
    )
    names = [model.actuator(i).name for i in range(model.nu)]
    ranges = [tuple(r) if limited else None
              for r, limited in zip(model.actuator_ctrlrange, model.actuator_ctrllimited, strict=True)]  # fmt: skip
    return ModelLayout(str(path), joints, tuple(map(ActuatorLayout, names, ranges)))


def print_preview(imported: Imported, mapping: Mapping) -> None:
    """What was understood: a row a channel, then time, shapes and doubts."""
    rows, lines = summary(imported, mapping)
    table = Table()
    for title in ("channel", "column", "recorded in", "unit"):
        table.add_column(title, overflow="fold")
    for title in ("min", "max", "rms"):
        table.add_column(title, justify="right")
    for r in rows:
        numbers = (f"{v:.4g}" for v in (r.minimum, r.maximum, r.rms))
        table.add_row(*map(escape, (r.name, r.column, r.recorded_in or "as is", r.unit or "-")), *numbers)
    console = Console()
    console.print(table)
    for line in lines:
        console.print(escape(line), soft_wrap=True, highlight=False)
    for note in imported.notes:
        console.print(f"[yellow]note[/]: {escape(note)}", soft_wrap=True, highlight=False)
