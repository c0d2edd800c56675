"""What a diagnosis leaves open, as values: explanations, and how the recordings were measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from idapt_pl.effects.base import Effect, effect_from_dict


@dataclass(frozen=True)
class ExplainingEffect:
    """An effect of an explanation.

    Attributes:
        effect: with the values that were fitted.
        free: nominal value and scale (what a noticeable change is about) of each parameter that can be fitted.
    """

    effect: Effect
    free: Mapping[str, tuple[float, float]]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        free = {name: {"nominal": nominal, "scale": scale} for name, (nominal, scale) in self.free.items()}
        return {**self.effect.to_dict(), "free": free}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> ExplainingEffect:
        """From an entry of ``report.json``."""
        free = {name: (float(p["nominal"]), float(p["scale"])) for name, p in entry["free"].items()}
        return cls(effect_from_dict({k: v for k, v in entry.items() if k != "free"}), free)


class Standing(StrEnum):
    """How well an explanation does beside the others."""

    FOUND = "found"
    """It is what the diagnosis names."""
    EQUIVALENT = "equivalent"
    """It does as well on these recordings."""
    RUNNER_UP = "runner-up"
    """It does a little worse on these recordings."""


@dataclass(frozen=True)
class Explanation:
    """One account of the recordings.

    Attributes:
        standing: beside the others.
        instead: the effect that it has in the place of one of those found, as ``effect(target)``; empty for what was
            found.
        effects: all of them but the declared ones.
        loss: what it leaves on held-out episodes, squared and in units of the noise.
        probability: by the recordings and by how usual its effects are; what all of them lack to 1 is that something
            else is missing, or more.
    """

    standing: Standing
    instead: str
    effects: Sequence[ExplainingEffect]
    loss: float
    probability: float

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "standing": self.standing.value,
            "instead": self.instead,
            "effects": [e.to_dict() for e in self.effects],
            "loss": self.loss,
            "probability": self.probability,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Explanation:
        """From an entry of ``report.json``."""
        effects = tuple(map(ExplainingEffect.from_dict, entry["effects"]))
        return cls(
            Standing(entry["standing"]), entry["instead"], effects, float(entry["loss"]), entry.get("probability", 0.0)
        )


@dataclass(frozen=True)
class Measurement:
    """How recordings were measured, and in which windows predictions were compared with them.

    Attributes:
        control_period: s.
        window_steps: control steps in a window.
        velocities: whether they were measured.
        sensor_noise: standard deviation of every channel: positions, then velocities where they were measured.
        initial_state_noise: of the state that a window begins with, positions and velocities, (2 nv,).
    """

    control_period: float
    window_steps: int
    velocities: bool
    sensor_noise: Sequence[float]
    initial_state_noise: Sequence[float]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "control_period_s": self.control_period,
            "window_steps": self.window_steps,
            "velocities": self.velocities,
            "sensor_noise": list(self.sensor_noise),
            "initial_state_noise": list(self.initial_state_noise),
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Measurement:
        """From ``report.json``."""
        return cls(
            float(entry["control_period_s"]),
            int(entry["window_steps"]),
            bool(entry["velocities"]),
            tuple(map(float, entry["sensor_noise"])),
            tuple(map(float, entry["initial_state_noise"])),
        )
