"""What a comparison of recordings says, as values; the entry ``recordings`` of ``report.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from idapt_pl.diagnosis.answer.result import EffectEstimate, ParameterEstimate
from idapt_pl.recording_sets.join import RecordingSet

SetValue = tuple[str, str, str]
"""Effect, target, parameter."""


@dataclass(frozen=True)
class SetResult:
    """One file. Errors are NaN, and it has no values, where nothing of it is as long as a window.

    Attributes:
        recordings: which.
        before: error of the model as it was given, in units of the diagnosis, on all its episodes.
        common: with the common answer.
        own: with the same effects, their values fitted to this file alone.
        values: these values.
    """

    recordings: RecordingSet
    before: float
    common: float
    own: float
    values: Mapping[SetValue, ParameterEstimate]

    @property
    def comparable(self) -> bool:
        """Whether there is anything of it to compare."""
        return math.isfinite(self.own)

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        effects: dict[tuple[str, str], dict[str, Any]] = {}
        for (effect, target, name), p in self.values.items():
            effects.setdefault((effect, target), {})[name] = p.to_dict()
        errors = {"before": self.before, "common": self.common, "own": self.own}
        return {
            "file": self.recordings.name,
            "episodes": list(self.recordings.episodes),
            "error": {name: value if self.comparable else None for name, value in errors.items()},
            "effects": [{"effect": e, "target": t, "parameters": p} for (e, t), p in effects.items()],
        }


@dataclass(frozen=True)
class ChangedValue:
    """A value that differs between files.

    Attributes:
        value: which.
        lowest, highest: files with the lowest and the highest.
        sigmas: by how many standard errors these two differ.
    """

    value: SetValue
    lowest: str
    highest: str
    sigmas: float

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        effect, target, name = self.value
        found = {"effect": effect, "target": target, "parameter": name}
        return found | {"lowest_in": self.lowest, "highest_in": self.highest, "sigmas": round(self.sigmas, 1)}


@dataclass(frozen=True)
class SetComparison:
    """All files.

    Attributes:
        sets: in the order given.
        changed: values that differ between them, the surest first.
        unlike: files in which much more is left than in the others: something else differs there.
        effects: of the common answer.
        yardstick: what errors are in units of, in words.
    """

    sets: tuple[SetResult, ...]
    changed: tuple[ChangedValue, ...]
    unlike: tuple[str, ...]
    effects: tuple[EffectEstimate, ...]
    yardstick: str

    @property
    def comparable(self) -> tuple[SetResult, ...]:
        """Files of which there is anything to compare: one at least."""
        return tuple(s for s in self.sets if s.comparable)

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``, beside the rest."""
        return {
            "recordings": [s.to_dict() for s in self.sets],
            "changed": [c.to_dict() for c in self.changed],
            "unlike": list(self.unlike),
        }
