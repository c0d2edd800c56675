"""``idapt import``: recordings as a trajectory file.

CSV, NPZ, JSON lines, HDF5, Minari, LeRobot, MCAP, bags of ROS 1 (.bag) and ROS 2 (.db3 or a folder) and PX4's ULog
(.ulg) are read; no ROS is needed. A map says which column is which; --draft-map guesses it. See docs/guide/import.md.
"""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

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
    draft_map,
    fit_to_model,
    read_mapping,
    read_recording,
    resampled,
    summary,
    write_draft,
)
from datamodules.recordings.check import check_against_model, check_velocities

if TYPE_CHECKING:
    import mujoco

JOINT_TYPES = ("free", "ball", "slide", "hinge")
"""By MuJoCo's number for them (mjtJoint)."""
JOINT_TRANSMISSIONS = (0, 1)
"""MuJoCo's numbers (mjtTrn) of actuators that drive a joint."""
FIXED_GAIN = 0
"""MuJoCo's number (mjtGain) of actuators whose force is a multiple of their command."""
NO_BIAS = 0
"""MuJoCo's number (mjtBias) of actuators whose force is their command alone, as a motor's."""


def main(args: list[str]) -> int:
    """Run ``idapt import``.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    o = _options(args)
    if o.draft_map is not None:
        return draft(o.recordings, o.model, o.draft_map, o.format, o.actuators)
    if o.out is not None:
        keep_inputs(o.out, [*o.recordings, o.map, o.model])
    mapping, layout = read_mapping(o.map), None
    if o.model is not None:
        layout = read_layout(o.model, o.actuators)
        mapping = fit_to_model(mapping, layout)
    imported = import_recordings(o.recordings, mapping, layout, o.format, o.repair)
    if o.period is not None:
        imported = resampled(imported, o.period)
    print_preview(imported, mapping)
    if o.dry_run:
        print("dry run: nothing was written")
        return 0
    write_trajectories(o.out, imported.trajectories)
    print(f"{o.out}: {len(imported.trajectories)} episodes, {imported.trajectories.total_steps} steps")
    return 0


def _options(args: list[str]) -> argparse.Namespace:
    p = parser("import", __doc__)
    p.add_argument("recordings", nargs="+", metavar="RECORDING", help="file, dataset folder or Minari dataset id")
    what = p.add_mutually_exclusive_group(required=True)
    what.add_argument("--map", type=Path, help="YAML: which column is which joint, actuator and time")
    what.add_argument(
        "--draft-map", type=Path, metavar="MAP", help="guess the map from the first recording and --model, and write it"
    )
    p.add_argument("--model", type=Path, help="MJCF or URDF that the recording is checked against and ordered as")
    p.add_argument("--actuators", metavar="KIND", help="of a model that has none, as of idapt diagnose: motor, ...")
    p.add_argument("--out", type=Path, help="trajectory file to write (HDF5); not needed with --dry-run")
    p.add_argument("--format", choices=FORMATS, help="default: told by the recording's name")
    p.add_argument("--repair", action="store_true", help="drop rows without numbers, and single ones whose time slips")
    p.add_argument(
        "--period", type=float, metavar="SECONDS", help="resample to a longer period: nearest images, held commands"
    )
    p.add_argument("--dry-run", action="store_true", help="show what was understood and write nothing")
    o = p.parse_args(args)
    if o.draft_map is not None and o.model is None:
        p.error("--draft-map needs --model, whose joints and actuators it looks for")
    if o.draft_map is not None and o.out is not None:
        p.error("--draft-map writes no trajectory file; leave --out out, and give both in the next call")
    if o.draft_map is not None and (o.dry_run or o.repair or o.period is not None):
        p.error("--draft-map only writes a map: give --dry-run, --repair and --period in the next call")
    if o.map is not None and o.out is None and not o.dry_run:
        p.error("--out is required, or --dry-run to write nothing")
    return o


def draft(paths: list[str], model: Path, out: Path, format: str | None = None, actuators: str | None = None) -> int:
    """Guess the map of the first recording, write it, and say what is left to do. Returns the exit code.

    Args:
        paths: recordings.
        model: MJCF whose joints and actuators are wanted.
        out: the map to write; it must not be there yet.
        format: of the recordings; None: told by their names.
        actuators: of a model that has none, as the option gives them.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    layout = read_layout(model, actuators)
    if not layout.actuators:
        print(f"{model} has no actuators, so nothing is taken for a command: say what drives it with --actuators motor")
    made = draft_map(paths[0], layout, format)
    write_draft(out, made)
    missing = made.missing()
    print(f"{out}: a draft, made of {paths[0]}; read every line of it")
    if len(paths) > 1:
        print(
            f"only that one of {len(paths)} recordings was looked at: they are not joined, each has episodes of its own"
        )
    if missing:
        print(f"to fill in: {', '.join(missing)}")
    options = (f" --format {format}" if format else "") + (
        f" --actuators {shlex.quote(actuators)}" if actuators else ""
    )
    print(
        "then: idapt import " + shlex.join([*paths, "--map", str(out), "--model", str(model)]) + f"{options} --dry-run"
    )
    return 0


def import_recordings(
    paths: list[str],
    mapping: Mapping,
    layout: ModelLayout | None = None,
    format: str | None = None,
    repair: bool = False,
) -> Imported:
    """Read, convert and check recordings.

    Args:
        paths: files, folders or Minari ids.
        mapping: which column is what, already in the model's order.
        layout: of the model that they are checked against, or None.
        format: of the recordings; None: told by their names.
        repair: leave out rows that lack a number, and single rows whose time repeats or goes back.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    recorded = []
    for path in tqdm(paths, unit="file", leave=False, disable=len(paths) < 2 or not show_bar()):
        recorded += read_recording(path, mapping, format)
    names = [Path(path).name for path in paths]
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    imported = convert(recorded, mapping, f"idapt import: {', '.join(names[:5])}{more}", repair)
    notes = check_velocities(imported, mapping)
    if layout is not None:
        notes += check_against_model(imported, layout)
    return replace(imported, notes=imported.notes + notes)


def read_layout(path: Path, actuators: str | None = None) -> ModelLayout:
    """Names, types and ranges of a model's joints and actuators.

    What has no name goes by its number, ``joint0`` and ``actuator0``; an actuator rather by its joint's name.

    Raises:
        RecordingError: if the model cannot be read.
    """
    from idapt_pl.robot_files.actuators import parse_actuators
    from idapt_pl.robot_files.read import read_robot

    try:
        model = read_robot(path, None if actuators is None else parse_actuators(actuators)).spec.compile()
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
    ranges = [command_range(model, i) for i in range(model.nu)]
    driven = [
        model.joint(model.actuator_trnid[i, 0]).name if model.actuator_trntype[i] in JOINT_TRANSMISSIONS else ""
        for i in range(model.nu)
    ]
    force = [bool(bias == NO_BIAS) for bias in model.actuator_biastype]
    return ModelLayout(str(path), joints, tuple(map(ActuatorLayout, names, ranges, driven, force)))


def command_range(model: mujoco.MjModel, i: int) -> tuple[float, float] | None:
    """Range of an actuator's control; of a motor without one, what its joint's effort limit lets through."""
    if model.actuator_ctrllimited[i]:
        return tuple(model.actuator_ctrlrange[i].tolist())
    j, scale = model.actuator_trnid[i, 0], float(model.actuator_gear[i, 0] * model.actuator_gainprm[i, 0])
    motor = model.actuator_biastype[i] == NO_BIAS and model.actuator_gaintype[i] == FIXED_GAIN and scale
    if not motor or model.actuator_trntype[i] not in JOINT_TRANSMISSIONS or not model.jnt_actfrclimited[j]:
        return None
    low, high = sorted((model.jnt_actfrcrange[j] / scale).tolist())
    return low, high


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
