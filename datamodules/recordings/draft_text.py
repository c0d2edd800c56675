"""A draft of a map as YAML: one line an entry, each with why, and what could not be guessed commented out."""

from __future__ import annotations

import json
import re
import textwrap
from pathlib import Path
from typing import Any

import yaml

from datamodules.atomic import write_atomically
from datamodules.recordings.draft import Draft, Line
from datamodules.recordings.errors import RecordingError

SHOWN = 100
"""So many columns that are left are listed; the rest is counted."""
WIDTH = 110


def write_draft(path: Path, draft: Draft) -> None:
    """Write a draft to a file that is not there yet.

    Raises:
        RecordingError: if it is there.
    """
    if path.exists() or path.is_symlink():
        raise RecordingError(f"{path}: is there already; a draft is never written over a file, name another one")
    write_atomically(path, lambda temporary: temporary.write_text(draft_text(draft), encoding="utf-8"))


def draft_text(draft: Draft) -> str:
    """The draft as YAML, which `idapt import` reads as it is if nothing is missing."""
    lines = [
        f"# Drafted from {_comment(draft.recording)} ({draft.rows} rows looked at) and {_comment(draft.model)}.",
        "# Every line is a guess: read why. Signs and offsets cannot be seen in a recording: compare with the robot.",
        "# Fill in what is commented out. Keys and units: docs/guide/import.md, The map.",
    ]
    lines += [f"{key}: {_flow(value)}" for key, value in draft.settings.items()]
    lines += _entry("", "time", draft.time, "{column: ..., unit: s}")
    if draft.time.entry is None:
        lines += ["# dt: 0.01  # or this, the seconds between rows"]
    if draft.episodes is not None:
        lines += _entry("", "episodes", Line({"column": draft.episodes.entry}, draft.episodes.why), "")
    lines.append("joints:")
    for name, position in draft.positions.items():
        lines.append(("  # " if position.entry is None else "  ") + f"{quoted(name)}:")
        example = "{column: [...]}" if " list of columns" in position.why else "{column: ..., unit: rad}"
        lines += _entry("    ", "position", position, example)
        if (velocity := draft.velocities.get(name)) is not None:
            lines += _entry("    ", "velocity", velocity, "{column: ..., unit: rad/s}")
        elif position.entry is not None:
            lines.append("    # velocity: {column: ...}  # not found; qvel is written if every joint has one")
        if (axes := draft.axes.get(name)) is not None:
            lines += _entry("    ", "axes", axes, "")
    if draft.actuators:
        lines.append("actuators:")
        for name, command in draft.actuators.items():
            lines += _entry("  ", quoted(name), command, "{column: ...}")
    return "\n".join(lines + _left(draft)) + "\n"


def _entry(indent: str, key: str, line: Line, example: str) -> list[str]:
    if line.entry is None:
        return [f"{indent}# {key}: {example}  # {_comment(line.why)}: which of the columns left?"]
    return [f"{indent}{key}: {_flow(line.entry)}  # {_comment(line.why)}"]


def _left(draft: Draft) -> list[str]:
    """The columns left, as comments."""
    if not draft.left:
        return []
    names = [quoted(name) for name in draft.left[:SHOWN]]
    if len(draft.left) > SHOWN:
        names.append(f"... ({len(draft.left) - SHOWN} more)")
    listed = textwrap.wrap(", ".join(names), WIDTH, break_long_words=False, break_on_hyphens=False)
    title = "# Columns left. What you want to keep goes under infos, as name: column."
    return [title, *(f"#   {text}" for text in listed)]


def quoted(name: str) -> str:
    """A name as YAML, within a flow mapping too; in quotes if it needs them."""
    if re.fullmatch(r"[A-Za-z_][\w.]*", name, re.ASCII) and yaml.safe_load(name) == name:
        return name
    return json.dumps(name, ensure_ascii=not name.isprintable())


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(part) for part in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return f"{value:g}"
    return (
        value if re.fullmatch(r"[A-Za-z]+(/s|:\d+(/s)?)?", value) and yaml.safe_load(value) == value else quoted(value)
    )


def _comment(text: str) -> str:
    """Text for a comment, which ends with its line."""
    return "".join(c if c.isprintable() else "?" for c in text)
