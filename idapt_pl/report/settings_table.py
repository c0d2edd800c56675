"""Values to take over: tables for the page of a diagnosis and for ``settings.md``."""

from __future__ import annotations

from collections.abc import Sequence

from idapt_pl.effects.wording import format_estimate, format_number, phrase_at
from idapt_pl.report.actuator_settings import TERMS, DriveSettings
from idapt_pl.report.changed_settings import ChangedSetting
from idapt_pl.report.html import details, paragraph, preformatted, row, section, table

MJCF_HEADS = ("element", "name", "attribute", "old", "new", "95 %")
ISAAC_NOTE = (
    "Names as in Isaac Lab 2 (3 renames limits); the terms are those of any PD drive. Damping is the drive's and the "
    "joint's own together, which is the same where the velocity target is 0. Friction is an effort, as in Isaac Sim "
    "from 5 on. The delay is in seconds here and in physics steps there: divide by the time step."
)
MOST_ROWS = 40
"""Rows of a table on the page; settings.md has all."""


def mjcf_cells(c: ChangedSetting) -> tuple[str, ...]:
    """One attribute as cells."""
    return c.element, c.name or "-", c.attribute, c.old, c.new, c.interval or "-"


def drive_heads() -> tuple[str, ...]:
    """Heads of the table of drives."""
    return "joint", "commands", *(f"{term} ({unit})" for term, unit in TERMS.items())


def drive_cells(d: DriveSettings) -> tuple[str, ...]:
    """One drive as cells: values, with intervals where they were found."""
    cells = []
    for term in TERMS:
        value = d.values.get(term)
        if value is None:
            cells.append("-")
        elif term in d.intervals:
            cells.append("{} ({})".format(*format_estimate(value, d.intervals[term])))
        else:
            cells.append(format_number(value, 4))
    return d.joint, "positions" if d.servo else "efforts", *cells


def config_text(drives: Sequence[DriveSettings]) -> str:
    """A piece of a config, a group for each joint."""
    lines = ["actuators = {"]
    for d in drives:
        delayed = "delay" in d.values
        values = {k: d.values[k] for k in ("stiffness", "damping", "armature", "friction") if k in d.values}
        if "effort_limit" in d.values:
            values["effort_limit" if delayed else "effort_limit_sim"] = d.values["effort_limit"]
        told = "".join(f" {k}={v:.6g}," for k, v in values.items())
        kind = "DelayedPDActuatorCfg" if delayed else "ImplicitActuatorCfg"
        if delayed:
            steps = f"round({d.values['delay']:.4g} / sim_dt)"
            told += f" min_delay={steps}, max_delay={steps},"
        lines.append(f'    "{d.joint}": {kind}(joint_names_expr=["{d.joint}"],{told[:-1]}),')
    return "\n".join([*lines, "}"])


def settings_markdown(
    changes: Sequence[ChangedSetting], drives: Sequence[DriveSettings], unsaid: Sequence[str], names: Sequence[str],
    outside: Sequence[tuple[str, str]],
) -> str:  # fmt: skip
    """The text of ``settings.md``.

    Args:
        changes: of the MJCF.
        drives: of the repaired model.
        unsaid: what the terms of drives leave out.
        names: of the model and the recordings.
        outside: effects that MJCF has no words for, as (effect, target).
    """
    parts = [f"# Values to set\n\nFrom recordings {names[1]}, for the model {names[0]}.\n\n## In MJCF\n\n"]
    if changes:
        parts.append(markdown_table(MJCF_HEADS, [mjcf_cells(c) for c in changes]))
    else:
        parts.append("Nothing: no value of the model is to be changed.\n")
    if outside:
        told = "\n".join(f"- {phrase_at(*o)}" for o in outside)
        parts.append(f"\nMJCF has no words for these; they are in effects.yaml alone:\n\n{told}\n")
    if drives:
        parts.append(f"\n## As an actuator config (Isaac style)\n\n{ISAAC_NOTE}\n\n")
        parts.append(markdown_table(drive_heads(), [drive_cells(d) for d in drives]))
        parts.append(f"\n```python\n{config_text(drives)}\n```\n\nLeft out:\n\n")
        parts.append("\n".join(f"- {u}" for u in unsaid) + "\n")
    return "".join(parts)


def markdown_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |\n" for cells in lines)


def settings_to_take(changes: Sequence[ChangedSetting], drives: Sequence[DriveSettings], unsaid: Sequence[str]) -> str:
    """The section of the page; empty where nothing changes."""
    if not changes:
        return ""
    parts = [table(MJCF_HEADS, [row(*mjcf_cells(c)) for c in changes[:MOST_ROWS]])]
    if len(changes) > MOST_ROWS:
        parts.append(paragraph(f"{len(changes) - MOST_ROWS} more are in settings.md.", "small"))
    if drives:
        parts.append(
            details(
                "The same as an actuator config (Isaac style)",
                table(drive_heads(), [row(*drive_cells(d)) for d in drives]),
                preformatted(config_text(drives)),
                paragraph(ISAAC_NOTE, "small"),
                paragraph(f"Left out: {'; '.join(unsaid)}.", "small"),
            )
        )
    parts.append(paragraph("settings.md beside this page has the same as text.", "small"))
    return section("Values to set", *parts)
