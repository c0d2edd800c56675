"""How far what was found may be off: the intervals of effects that a run adds to its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp
from typing import Any

from idapt_pl.effects.distribution import DomainDistribution, within_intervals


def found_intervals(
    effects: Sequence[Mapping[str, Any]], estimates: Sequence[Mapping[str, Any]], refined: Sequence[Mapping[str, Any]]
) -> DomainDistribution:
    """Uniform over the 95 % intervals of effects; a parameter without one stays as it was found.

    Args:
        effects: those that were added, in their YAML form.
        estimates: of the discovery that found them, with ``ci95`` (``effects.json``).
        refined: values that later searches gave them, with ``log_halfwidth`` (``known_start_search.json``); they count
            more.
    """
    told = []
    for effect in effects:
        key = effect["effect"], effect["target"]
        intervals: dict[str, tuple[float, float]] = {}
        for estimate in (e for e in estimates if (e["effect"], e["target"]) == key):
            known = {name: p["ci95"] for name, p in estimate["parameters"].items()}
            intervals |= {name: (min(ci), max(ci)) for name, ci in known.items() if ci is not None}
        for r in (r for r in refined if (r["effect"], r["target"]) == key and r["log_halfwidth"] is not None):
            about, far = r["after"], exp(r["log_halfwidth"])
            intervals[r["parameter"]] = (min(about / far, about * far), max(about / far, about * far))
        told.append({**effect, "ci95": {k: v for k, v in intervals.items() if k in effect["parameters"]}})
    return within_intervals(told)
