"""A run in minutes that goes through every stage, to see whether everything works before the real one takes hours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from idapt_pl.ranges import Range, check_ranges

AT_LEAST = {
    "schedule.images": 300, "schedule.source_images": 300, "schedule.interactions": 150, "schedule.source_policy": 40,
    "schedule.repaired_visual": 20,
    **{
        f"schedule.{part}.{name}": least
        for part in ("pretrain", "finetune")
        for name, least in (
            ("state_predictor", 50), ("visual", 20), ("estimator", 20), ("policy", 40), ("dynamics", 1),
            ("rehearsed", 20), ("filter", 20),
        )
    },
    "teacher.steps": 200, "teacher.adapt": 200, "teacher.dagger": 200, "teacher.rehearse": 1000, "teacher.harden": 200,
    "labels.members": 8, "feeding.warmup_steps": 40, "feeding.garat_rollout": 200, "episodes": 2,
}  # fmt: skip
"""How long whatever a config has stays at least; what it has not is not begun."""


def shorten(config: Any) -> float:
    """Divide what a run's stages are long by ``shorten``, changed in place; it is 1 then: a resumed run is not again.

    Args:
        config: what a parser made of a run's options, its null lengths filled.

    Returns:
        What they were divided by, which ``run.json`` keeps.

    Raises:
        ValueError: if it is less than 1, or too large to mean anything.
    """
    by = config["shorten"]
    check_ranges("", {"shorten": by}, {"shorten": Range(1, 1e4)})
    if by == 1:
        return by
    for key, least in AT_LEAST.items():
        if number := config[key]:
            config[key] = max(min(number, least), round(number / by))
    config["schedule.grounding_steps"] = min(1, config["schedule.grounding_steps"])
    config["shorten"] = 1.0
    return by


def other_keys(different: Sequence[str], was: float, now: float) -> list[str]:
    """Keys in which two configs differ, with ``--shorten`` in place of the lengths that it divides.

    Args:
        different: dotted keys.
        was: what the lengths of the one were divided by.
        now: likewise, of the other.
    """
    if was == now:
        return list(different)
    lengths = {*AT_LEAST, "schedule.grounding_steps"}
    return [f"--shorten {was:g} against {now:g}", *(key for key in different if key not in lengths)]


def shortened_sentence(by: float) -> str:
    """What a run whose lengths were divided is worth; empty where they were not."""
    return "" if by == 1 else f"lengths divided by {by:g}: this shows that it runs, not what it can reach"
