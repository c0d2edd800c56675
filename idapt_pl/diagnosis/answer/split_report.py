"""How often each effect is chosen, as values; :meth:`SplitReport.to_dict` is a part of ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from idapt_pl.diagnosis.answer.false_discoveries import Key


@dataclass(frozen=True)
class SplitSearch:
    """A search with some episodes held out.

    Attributes:
        held_out_episodes: their numbers.
        effects: what it chose: values by parameter, by effect and target.
    """

    held_out_episodes: Sequence[int]
    effects: Mapping[Key, Mapping[str, float]]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        effects = [{"effect": e, "target": t, "parameters": dict(x)} for (e, t), x in self.effects.items()]
        return {"held_out_episodes": list(self.held_out_episodes), "effects": effects}


@dataclass(frozen=True)
class TimesChosen:
    """An effect that at least one of the searches chose.

    Attributes:
        key: effect and target.
        times: how many chose it.
        ranges: the smallest and the largest value of every parameter.
    """

    key: Key
    times: int
    ranges: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class SplitReport:
    """Searches that hold out other episodes each; the first is the diagnosis itself."""

    searches: Sequence[SplitSearch]

    def times_chosen(self) -> list[TimesChosen]:
        """Every effect that was chosen, the most often chosen first."""
        keys = list(dict.fromkeys(key for s in self.searches for key in s.effects))
        made = []
        for key in keys:
            values = [s.effects[key] for s in self.searches if key in s.effects]
            names = dict.fromkeys(name for v in values for name in v)
            ranges = {n: (min(got := [v[n] for v in values if n in v]), max(got)) for n in names}
            made.append(TimesChosen(key, len(values), ranges))
        return sorted(made, key=lambda t: -t.times)

    def unsteady(self) -> list[TimesChosen]:
        """What was found, but not in more than half of the searches."""
        found = self.searches[0].effects
        return [t for t in self.times_chosen() if t.key in found and 2 * t.times <= len(self.searches)]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        counted = [
            {
                "effect": t.key[0],
                "target": t.key[1],
                "times": t.times,
                "ranges": {n: list(r) for n, r in t.ranges.items()},
            }
            for t in self.times_chosen()
        ]
        return {"searches": [s.to_dict() for s in self.searches], "times_chosen": counted}
