"""The files of a motion: the commands, a picture, a page, and what it does as JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from idapt_pl.effects.wording import phrase_at, unit_at
from idapt_pl.excitation.design import SEPARATED, MotionDesign
from idapt_pl.excitation.figures import motion_clip, motion_figure
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.limits import servo_dof
from idapt_pl.excitation.page import motion_page
from idapt_pl.excitation.plan import MotionPlan
from idapt_pl.excitation.rivals import LeftOpen, Rival
from idapt_pl.excitation.wording import inseparable_groups, motion_in_words, plays_needed
from idapt_pl.files import write_bytes, write_json

MOTION_SCHEMA = "idapt.excitation/1"


def motion_files(out: Path) -> list[Path]:
    """All that is written beside and with the commands."""
    return [out, *(out.with_suffix(s) for s in (".json", ".html", ".png", ".gif"))]


def write_motion(
    out: Path, design: MotionDesign, rivals: Sequence[Rival], forecaster: MotionForecaster, plan: MotionPlan,
    left_open: LeftOpen, model_name: str, report_name: str,
) -> dict[str, Any]:  # fmt: skip
    """Write a motion's files.

    Args:
        out: of the commands (CSV); the others have its name with other endings.
        design: the motion.
        rivals: the explanations it is about.
        forecaster: that simulated them.
        plan: what was asked.
        left_open: of the report.
        model_name: of the model, for the page.
        report_name: of the report.

    Returns:
        What is in the JSON file.
    """
    parameters = information_rows(design, rivals[0], left_open.intervals, forecaster.model)
    entry = motion_entry(design, rivals, forecaster, plan, parameters)
    drawn, clip = motion_figure(design, rivals, forecaster, plan), motion_clip(design, forecaster)
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="png", dpi=130)
    names = model_name, report_name, out.name
    page = motion_page(design, rivals, forecaster, plan.goal, parameters, drawn, clip, names)
    _, as_json, html, png, gif = motion_files(out)
    write_bytes(out, commands_csv(design, forecaster).encode())
    write_bytes(png, buffer.getvalue())
    write_bytes(html, page.encode())
    if clip:
        write_bytes(gif, clip)
    else:
        gif.unlink(missing_ok=True)  # it would show another motion
    write_json(as_json, entry)
    return entry


def commands_csv(design: MotionDesign, forecaster: MotionForecaster) -> str:
    """The commands as a table; the last row is the command that is held at the end."""
    model, buffer = forecaster.model, io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    heads = [f"{model.actuator(i).name} [{command_unit(model, i)}]" for i in range(model.nu)]
    writer.writerow(["time [s]", *heads])
    for k, u in enumerate([*design.commands, design.commands[-1]]):
        writer.writerow([f"{k * forecaster.dt:.6g}", *(f"{v:.6g}" for v in u)])
    return buffer.getvalue()


def command_unit(model: mujoco.MjModel, actuator: int) -> str:
    """Unit of an actuator's command: of its joint for servos, of a force for motors of gear 1, else just a command."""
    dof, slide = servo_dof(model, actuator), int(mujoco.mjtJoint.mjJNT_SLIDE)
    if dof is not None:
        return "m" if model.jnt_type[model.dof_jntid[dof]] == slide else "rad"
    on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    plain = model.actuator_gear[actuator, 0] == 1 and model.actuator_gainprm[actuator, 0] == 1
    if on_joint and plain and not model.actuator_biasprm[actuator, 1]:
        return "N" if model.jnt_type[model.actuator_trnid[actuator, 0]] == slide else "N·m"
    return "command"


def motion_entry(
    design: MotionDesign,
    rivals: Sequence[Rival],
    forecaster: MotionForecaster,
    plan: MotionPlan,
    parameters: Sequence[dict],
) -> dict[str, Any]:
    """The content of the JSON file."""
    pairs = [
        {"first": a.name, "second": b.name, "separation": four_digits(d), "best_separation": four_digits(best),
         "told_apart": bool(d >= SEPARATED), "plays": plays_needed(a, b, d) if d >= SEPARATED else None}
        for (a, b), d, best in zip(combinations(rivals, 2), design.separations, design.reachable, strict=True)
    ]  # fmt: skip
    return {
        "schema": MOTION_SCHEMA,
        "goal": plan.goal.value,
        "control_period_s": forecaster.dt,
        "steps": len(design.commands),
        "start_qpos": [float(v) for v in forecaster.rest],
        "explanations": [
            {"name": r.name, "standing": r.standing.value, "effects": [e.to_dict() for e in r.effects]} for r in rivals
        ],
        "pairs": pairs,
        "threshold": SEPARATED,
        "inseparable": inseparable_groups(design, rivals),
        "words": motion_in_words(design, rivals, plan.goal),
        "parameters": list(parameters),
        "limits": plan.limits.to_dict(forecaster.model),
        "margins": [m.to_dict() for m in design.margins],
        "motions_tried": design.tried,
        "motions_safe": design.safe,
        "seed": plan.seed,
    }


def four_digits(value: float) -> float:
    """A number with four significant digits."""
    return float(f"{value:.4g}")


def finite_or_none(value: float) -> float | None:
    """A number with four significant digits; None, as JSON has no infinity."""
    return four_digits(value) if np.isfinite(value) else None


def information_rows(
    design: MotionDesign, rival: Rival, intervals: Mapping[tuple[str, str, str], tuple[float, float]],
    model: mujoco.MjModel,
) -> list[dict[str, Any]]:  # fmt: skip
    """What the motion tells of the parameters of what was found."""
    rows, deviations = [], iter(design.deviations)
    for c, x in zip(rival.candidates, rival.x, strict=True):
        for name, value, unit in zip(c.names, x, c.units(), strict=True):
            interval = intervals.get((c.kind.name, c.target, name))
            rows.append(
                {
                    "effect": c.kind.name,
                    "target": c.target,
                    "parameter": name,
                    "name": f"{phrase_at(c.kind.name, c.target)}: {name}",
                    "value": float(value),
                    "unit": unit_at(model, c.target, unit),
                    "half_width_now": None if interval is None else four_digits((interval[1] - interval[0]) / 2),
                    "half_width_from_motion": finite_or_none(1.96 * next(deviations)),
                }
            )
    return rows
