"""Visual effects that a source lacks, as values; ``looks.json`` of a run folder and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from idapt_pl.effects import Effect, effect_from_dict


@dataclass(frozen=True)
class VisualEstimate:
    """A visual effect as fitted.

    Attributes:
        effect: its name.
        target: MJCF name of the element; several geoms of one colour are separated by spaces.
        unit: of all numbers.
        nominal: name of a number to its value in the source.
        estimate: likewise, as fitted.
        std: likewise, standard deviation of the estimate, given that all that is wrong is among the effects found.
    """

    effect: str
    target: str
    unit: str
    nominal: dict[str, float]
    estimate: dict[str, float]
    std: dict[str, float]

    @property
    def key(self) -> tuple[str, str]:
        """Effect and target."""
        return self.effect, self.target


@dataclass(frozen=True)
class VisualEffects:
    """What the target's first frames show the source to lack. Errors are those of mean pictures of held-out episodes.

    Attributes:
        effects: to be added to the source.
        estimates: their numbers.
        before: error without them, root mean square, in 8-bit levels, noise taken off.
        after: with them.
        floor: what noise alone leaves.
        trail: effect that was added, and error after that, for each step of the search.
        picture: mean pictures of source, repaired source and target in a row, a PNG in base64.
    """

    effects: tuple[Effect, ...]
    estimates: tuple[VisualEstimate, ...]
    before: float
    after: float
    floor: float
    trail: tuple[tuple[str, float], ...]
    picture: str

    def to_dict(self) -> dict[str, Any]:
        """The content of ``looks.json``."""
        return {
            **vars(self),
            "effects": [e.to_dict() for e in self.effects],
            "estimates": [dict(vars(e)) for e in self.estimates],
            "trail": [list(step) for step in self.trail],
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> VisualEffects:
        """From the content of ``looks.json``; keys that do not belong to it are not looked at.

        Raises:
            KeyError: if a key is missing.
            ValueError: if there is an effect that is not known.
        """
        return cls(
            tuple(map(effect_from_dict, entry["effects"])),
            tuple(VisualEstimate(**e) for e in entry["estimates"]),
            entry["before"],
            entry["after"],
            entry["floor"],
            tuple((name, error) for name, error in entry["trail"]),
            entry["picture"],
        )
