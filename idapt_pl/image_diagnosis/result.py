"""What images show a source to lack, as values; ``effects.json`` of a run folder and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from idapt_pl.diagnosis.answer.result import ChannelError, EffectEstimate
from idapt_pl.effects import Effect, effect_from_dict


@dataclass(frozen=True)
class EnsembleBand:
    """Mean, least and greatest of an ensemble's members, a number for each control step."""

    mean: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> EnsembleBand:
        """From its JSON form."""
        return cls(**{name: tuple(values) for name, values in entry.items()})

    def to_dict(self) -> dict[str, list[float]]:
        """The JSON form."""
        return {name: list(values) for name, values in vars(self).items()}


@dataclass(frozen=True)
class ForecastChannel:
    """One position in an episode: as read of the target, and forecast without and with the effects found."""

    unit: str
    read: tuple[float, ...]
    before: EnsembleBand
    after: EnsembleBand

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> ForecastChannel:
        """From its JSON form."""
        bands = (EnsembleBand.from_dict(entry[name]) for name in ("before", "after"))
        return cls(entry["unit"], tuple(entry["read"]), *bands)

    def to_dict(self) -> dict[str, Any]:
        """The JSON form."""
        bands = {"before": self.before.to_dict(), "after": self.after.to_dict()}
        return {"unit": self.unit, "read": list(self.read), **bands}


@dataclass(frozen=True)
class ForecastExample:
    """An episode and its forecasts: control period in s, and joint to channel."""

    dt: float
    channels: dict[str, ForecastChannel]

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> ForecastExample:
        """From its JSON form."""
        return cls(entry["dt"], {name: ForecastChannel.from_dict(c) for name, c in entry["channels"].items()})

    def to_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {"dt": self.dt, "channels": {name: c.to_dict() for name, c in self.channels.items()}}


@dataclass(frozen=True)
class WindowEvidence:
    """What only a diagnosis by windows has.

    Attributes:
        found_in_control: what the same search finds in the control, where nothing is missing: errors of the sensor.
        negligible: effects found that too little of the error goes with, beyond what goes with the others.
        unknown_gain: standard deviation of the sensor's unknown gain, which intervals allow for.
    """

    found_in_control: tuple[EffectEstimate, ...]
    negligible: tuple[EffectEstimate, ...]
    unknown_gain: float


@dataclass(frozen=True)
class ForecastEvidence:
    """What only a diagnosis by forecasts has.

    Attributes:
        unknown_error: standard deviation of an estimate's logarithm by what G and the sensor get wrong on target
            images, which intervals allow for.
        example: a typical episode and its forecasts.
    """

    unknown_error: float
    example: ForecastExample


@dataclass(frozen=True)
class ImageDiagnosis:
    """What the target's images show the source to lack.

    Errors ``before`` and ``after`` are those of replayed windows in units of the sensor's noise
    (:class:`WindowEvidence`), or energy scores of forecasts (:class:`ForecastEvidence`). The control is recordings of
    the source itself, seen through G: there nothing is missing.

    Attributes:
        effects: found and believed.
        rejected: found and not believed.
        estimates: of both.
        excess: error in the target over that in the control; by windows in the channel where that is largest.
        explained: share of what is beyond the control's error that goes with the effects found, there.
        removed: share of the whole error that goes, of the ``target`` and, where effects are sought there, the
            ``control``.
        excluded_frames: shares of the frames that were not used since the sensor hardly knows such, of both.
        sensor_errors: on the control, each for every degree of freedom (:meth:`Calibration.to_dict`).
        before: error in the target without effects.
        after: with all that was found.
        target: channel to its errors.
        control: likewise.
        evidence: what it rests on.
    """

    effects: tuple[Effect, ...]
    rejected: tuple[Effect, ...]
    estimates: tuple[EffectEstimate, ...]
    excess: float
    explained: float
    removed: dict[str, float]
    excluded_frames: dict[str, float]
    sensor_errors: dict[str, list[float | None]]
    before: float
    after: float
    target: dict[str, ChannelError]
    control: dict[str, ChannelError]
    evidence: WindowEvidence | ForecastEvidence

    @property
    def by_forecasts(self) -> bool:
        """Whether effects were judged by forecasts."""
        return isinstance(self.evidence, ForecastEvidence)

    @property
    def forecast_evidence(self) -> ForecastEvidence:
        """What a diagnosis by forecasts rests on.

        Raises:
            TypeError: effects were judged by windows.
        """
        if not isinstance(self.evidence, ForecastEvidence):
            raise TypeError("a diagnosis by forecasts is needed, but effects were judged by windows")
        return self.evidence

    @property
    def negligible(self) -> tuple[EffectEstimate, ...]:
        """Effects found by windows that too little goes with; forecasts look for none further."""
        return self.evidence.negligible if isinstance(self.evidence, WindowEvidence) else ()

    @property
    def believed(self) -> tuple[EffectEstimate, ...]:
        """Estimates of the effects that were added to the source."""
        return tuple(filter(self.is_believed, self.estimates))

    @property
    def doubted(self) -> tuple[EffectEstimate, ...]:
        """Estimates of those that were found and not believed."""
        return tuple(e for e in self.estimates if not self.is_believed(e))

    def is_believed(self, estimate: EffectEstimate) -> bool:
        """Whether an effect was added to the source."""
        return estimate.key in {(e.name, e.target) for e in self.effects}

    def to_dict(self) -> dict[str, Any]:
        """The content of ``effects.json``."""
        in_control: tuple[EffectEstimate, ...] = ()
        allowance: dict[str, float] = {}
        example: dict[str, Any] = {}
        if isinstance(self.evidence, ForecastEvidence):
            allowance = {"unknown_error": self.evidence.unknown_error, "forecasts": True}
            example = {"example": self.evidence.example.to_dict()}
        else:
            allowance = {"unknown_gain": self.evidence.unknown_gain}
            in_control = self.evidence.found_in_control
        return {
            "effects": [e.to_dict() for e in self.effects],
            "disbelieved": [e.to_dict() for e in self.rejected],
            "left_out": [e.to_dict() for e in self.negligible],
            "estimates": [e.to_dict() for e in self.estimates],
            "made_up": [e.to_dict() for e in in_control],
            "excess": self.excess,
            "explained": self.explained,
            "removed": self.removed,
            "unread": self.excluded_frames,
            "sensor": self.sensor_errors,
            **allowance,
            "before": self.before,
            "after": self.after,
            "target": {name: c.to_dict() for name, c in self.target.items()},
            "control": {name: c.to_dict() for name, c in self.control.items()},
            **example,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> ImageDiagnosis:
        """From the content of ``effects.json``; keys that do not belong to it are not looked at.

        Run folders of earlier versions lack some keys, which are then empty.

        Raises:
            KeyError: if any other key is missing.
            ValueError: if there is an effect that is not known.
        """

        def estimates(key: str) -> tuple[EffectEstimate, ...]:
            return tuple(map(EffectEstimate.from_dict, entry.get(key, ())))

        def channels(key: str) -> dict[str, ChannelError]:
            return {name: ChannelError(**c) for name, c in entry[key].items()}

        evidence: WindowEvidence | ForecastEvidence
        if entry.get("forecasts"):
            evidence = ForecastEvidence(entry["unknown_error"], ForecastExample.from_dict(entry["example"]))
        else:
            evidence = WindowEvidence(estimates("made_up"), estimates("left_out"), entry.get("unknown_gain", 0.0))
        return cls(
            effects=tuple(map(effect_from_dict, entry["effects"])),
            rejected=tuple(map(effect_from_dict, entry["disbelieved"])),
            estimates=estimates("estimates"),
            excess=entry["excess"],
            explained=entry.get("explained", 0.0),
            removed=entry.get("removed", {}),
            excluded_frames=entry.get("unread", {}),
            sensor_errors=entry.get("sensor", {}),
            before=entry["before"],
            after=entry["after"],
            target=channels("target"),
            control=channels("control"),
            evidence=evidence,
        )
