"""Effects that a run's source is known to lack before it begins: what recordings of the robot's joints have told."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.effects import Effect
from idapt_pl.effects.effects_file import effects_from_list, read_effect_list
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.signals import SensorDelay
from idapt_pl.effects.wording import phrase_at
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)

KEY = "effects.known"


def fill_known(effects: Any) -> None:
    """Put the content of the file that a config names in place of its name, so that a run folder needs no other file.

    Args:
        effects: what a parser made of the key ``effects``; changed in place.

    Raises:
        ValueError: if there is no such file, or it holds no list.
    """
    if isinstance(effects["known"], str):
        effects["known"] = entries_of(effects["known"])


def entries_of(known: str | list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The list itself, or that of a file."""
    if not isinstance(known, str):
        return known
    try:
        return read_effect_list(Path(known))
    except ValueError as error:
        raise ValueError(f"{KEY}: {error}") from None


def known_effects(known: str | list[dict[str, Any]] | None, task: Task) -> tuple[Effect, ...]:
    """Effects to add to a task's source. Those of sensors of joints are left out, as images do not show them.

    Raises:
        ValueError: naming the entry that is none, does not fit the source, or changes its control period.
    """
    if known is None:
        return ()
    source = task.domain("source")
    effects = effects_from_list(entries_of(known), source.spec(), known if isinstance(known, str) else KEY)
    kept = tuple(e for e in effects if not isinstance(e, SensingEffect | SensorDelay))
    for left_out in (e for e in effects if e not in kept):
        log.info("%s: %s is left out, since images do not show it", KEY, phrase_at(left_out.name, left_out.target))
    keep_control_period(kept, task)
    return kept


def keep_control_period(effects: Sequence[Effect], task: Task) -> None:
    """A policy's control period is the robot's, so the source keeps its own.

    Raises:
        ValueError: if effects change it.
    """
    source = task.domain("source")
    before, after = (task.period(domain.compile()) for domain in (source, source.with_effects(*effects)))
    if not np.isclose(before, after):
        raise ValueError(
            f"{KEY}: numerics would make a control period of {after:.6g} s of the source's {before:.6g} s. Leave that "
            "entry out, or give the task's own model that time step"
        )
