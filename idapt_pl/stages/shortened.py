"""A run in minutes that goes through every stage, to see whether everything works before the real one takes hours."""

from __future__ import annotations

from typing import Any

from idapt_pl.ranges import Range, check_ranges

AT_LEAST = {
    "schedule.images": 300, "schedule.source_images": 300, "schedule.interactions": 150, "schedule.source_policy": 40,
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


def shorten(config: Any) -> None:
    """Divide what a run's stages are long by ``shorten``, changed in place; it is 1 then, as numbers say it all.

    Args:
        config: what a parser made of a run's options, its null lengths filled.

    Raises:
        ValueError: if it is less than 1, or too large to mean anything.
    """
    by = config["shorten"]
    check_ranges("", {"shorten": by}, {"shorten": Range(1, 1e4)})
    if by == 1:
        return
    for key, least in AT_LEAST.items():
        if number := config[key]:
            config[key] = max(min(number, least), round(number / by))
    config["schedule.grounding_steps"] = min(1, config["schedule.grounding_steps"])
    config["shorten"] = 1.0
