"""What a diagnosis says, as values; :meth:`DiagnosisResult.to_dict` is the content of ``report.json``.

Numbers are those of the report, rounded to what is worth reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar

from idapt_pl.diagnosis.answer.explanation import Explanation, Measurement
from idapt_pl.effects.base import Effect

if TYPE_CHECKING:
    from idapt_pl.diagnosis.answer.changes import ChangeReport
    from idapt_pl.diagnosis.answer.detection_limits import DetectionLimit
    from idapt_pl.diagnosis.answer.law_result import LawReport
    from idapt_pl.diagnosis.answer.split_report import SplitReport


class Verdict(StrEnum):
    """What a diagnosis comes to."""

    EFFECTS_FOUND = "effects_found"
    NO_MISSING_EFFECT = "no_missing_effect"
    UNEXPLAINED_RESIDUAL = "unexplained_residual"
    INSUFFICIENT_EXCITATION = "insufficient_excitation"


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter of an effect.

    Attributes:
        nominal: in the nominal model; a word where the parameter is no number, None where the model has none.
        estimate: from the recordings.
        ci95: 95 % interval; None where there is none.
        unit: of the three.
    """

    nominal: float | str | None
    estimate: float | str
    ci95: tuple[float, float] | None
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        interval = None if self.ci95 is None else list(self.ci95)
        return {"nominal": self.nominal, "estimate": self.estimate, "ci95": interval, "unit": self.unit}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> ParameterEstimate:
        """From an entry of ``report.json``."""
        interval = None if entry["ci95"] is None else tuple(entry["ci95"])
        return cls(entry["nominal"], entry["estimate"], interval, entry["unit"])


@dataclass(frozen=True)
class Alternative:
    """Another effect that explains the data as well.

    Attributes:
        effect: its name.
        target: MJCF name of what it acts on.
        parameters: its estimates by name.
        why: the two cannot be told apart.
    """

    effect: str
    target: str
    parameters: Mapping[str, float]
    why: str

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "effect": self.effect,
            "target": self.target,
            "parameters": dict(self.parameters),
            "why": self.why,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Alternative:
        """From an entry of ``report.json``."""
        return cls(entry["effect"], entry["target"], entry["parameters"], entry["why"])


@dataclass(frozen=True)
class EffectEstimate:
    """An effect to add to the model.

    Attributes:
        effect: its name.
        target: MJCF name of what it acts on.
        parameters: its estimates by name.
        fixed: parameters that were not estimated.
        error_after: on held-out episodes, with all effects found; None for numerics.
        error_without: the same without this one; None for numerics.
        equivalent: what explains the data as well.
        implausible: why no real machine has it, in words; empty where one may.
        probability: that it is there; None for numerics.
    """

    effect: str
    target: str
    parameters: Mapping[str, ParameterEstimate]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    error_after: float | None = None
    error_without: float | None = None
    equivalent: Sequence[Alternative] = ()
    implausible: str = ""
    probability: float | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Effect and target, which tell it from others."""
        return self.effect, self.target

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        entry: dict[str, Any] = {"effect": self.effect, "target": self.target}
        entry["parameters"] = {name: p.to_dict() for name, p in self.parameters.items()}
        errors: dict[str, Any] = {"error_after": self.error_after}
        if self.error_without is not None:
            errors = {"fixed": dict(self.fixed), **errors, "error_without": self.error_without}
        equivalent = [a.to_dict() for a in self.equivalent]
        told = {"implausible": self.implausible, "probability": self.probability}
        return {**entry, **errors, "equivalent": equivalent, **told}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> EffectEstimate:
        """From an entry of ``report.json``."""
        return cls(
            entry["effect"],
            entry["target"],
            {name: ParameterEstimate.from_dict(p) for name, p in entry["parameters"].items()},
            entry.get("fixed", {}),
            entry.get("error_after"),
            entry.get("error_without"),
            tuple(map(Alternative.from_dict, entry.get("equivalent", ()))),
            entry.get("implausible", ""),
            entry.get("probability"),
        )


@dataclass(frozen=True)
class ChannelError:
    """Root mean square of measured minus predicted in one channel, on held-out episodes.

    Attributes:
        before: under the model as it was given.
        after: with what was found.
        noise: standard deviation of the sensor.
        unit: of the three.
    """

    before: float
    after: float
    noise: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {"before": self.before, "after": self.after, "noise": self.noise, "unit": self.unit}


@dataclass(frozen=True)
class ErrorTable:
    """Errors on held-out episodes, in standard deviations of the measurement noise.

    Where that is negligible (:mod:`~idapt_pl.diagnosis.rounds.unexplained_forces`) they are of forces, not of
    forecasts, in units of the force that nothing explains.

    Attributes:
        steps: control steps in a window.
        horizon_s: how long that is, s.
        fit_episodes: numbers of the episodes fitted on.
        held_out_episodes: and of those judged on.
        before: error of the model as it was given.
        after: with what was found.
        median_after: that of the typical window.
        ceiling: of the model as it was given, corrected by a black box.
        removed_share: of the removable squared error.
        black_box_could_still_remove: share of the squared error left that state and commands predict.
        channels: errors of forecasts in their own units, by channel.
        unexplained: force that nothing explains, by channel, in N·m or N, where errors are of forces; else empty.
    """

    NOISE_FLOOR: ClassVar[float] = 1.0
    SPLIT: ClassVar[str] = "held-out episodes"

    steps: int
    horizon_s: float
    fit_episodes: Sequence[int]
    held_out_episodes: Sequence[int]
    before: float
    after: float
    median_after: float
    ceiling: float
    removed_share: float
    black_box_could_still_remove: float
    channels: Mapping[str, ChannelError]
    unexplained: Mapping[str, float] = field(default_factory=dict)

    @property
    def yardstick(self) -> str:
        """What the errors are in units of, in words."""
        return "the force that nothing explains" if self.unexplained else "the measurement noise"

    @property
    def metric(self) -> str:
        """What the errors are, in words."""
        if self.unexplained:
            return "rms of the force that the model lacks (Huber, 4 sigma), single control steps"
        return f"rms of the whitened prediction error (Huber, 4 sigma), windows of {self.steps} control steps"

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "metric": self.metric,
            "unit": f"standard deviations of {self.yardstick}",
            "split": self.SPLIT,
            "fit_episodes": list(self.fit_episodes),
            "held_out_episodes": list(self.held_out_episodes),
            "horizon_s": self.horizon_s,
            "before": self.before,
            "after": self.after,
            "median_after": self.median_after,
            "noise_floor": self.NOISE_FLOOR,
            "ceiling": self.ceiling,
            "removed_share": self.removed_share,
            "black_box_could_still_remove": self.black_box_could_still_remove,
            "per_channel": {name: c.to_dict() for name, c in self.channels.items()},
            "unexplained_force": dict(self.unexplained),
        }


@dataclass(frozen=True)
class RejectedCandidate:
    """A candidate that was tried in a round and not accepted.

    Attributes:
        effect: its name.
        target: MJCF name of what it acts on.
        parameters: where its fit led, by name.
        fixed: parameters that were not estimated.
        round: counted from 1.
        score: squared whitened error that the screen expects it to remove.
        held_out_gain: what a refit with it takes off the squared held-out error; None where it was not refitted.
        rejected_because: in words.
        implausible: whether it was because no real machine has it.
    """

    effect: str
    target: str
    parameters: Mapping[str, float]
    fixed: Mapping[str, Any]
    round: int
    score: float
    held_out_gain: float | None
    rejected_because: str
    implausible: bool = False

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "effect": self.effect,
            "target": self.target,
            "parameters": dict(self.parameters),
            "fixed": dict(self.fixed),
            "round": self.round,
            "score": self.score,
            "held_out_gain": self.held_out_gain,
            "rejected_because": self.rejected_because,
            "implausible": self.implausible,
        }


@dataclass(frozen=True)
class DiagnosisResult:
    """What a diagnosis says.

    Attributes:
        verdict: what it comes to.
        error: on held-out episodes, before and after.
        effects: to add to the model.
        declared: effects known beforehand.
        candidates: what was tried and not accepted, by round and score.
        signature: what an unexplained residual looks like; empty if there is none.
        next_experiment: what to record next; empty if nothing would help.
        runtime_s: how long it took.
        explanations: what was found, then all that does as well; empty where nothing was found.
        measurement: how the recordings were measured.
        laws: what a search for laws came to; None where none was made.
        changes: whether effects stay the same throughout; None where that was not tested.
        not_tried: what a quick look left out, in words.
        false_discovery_rate: share of false ones among the effects that the user bears; None if none was set.
        not_named: effects that are not probable enough for it.
        splits: how often each effect is chosen as other episodes are held out; None where that was not asked for.
        mending: the command that takes out deployment faults which were left in the recordings; empty where none were.
        limits: how small a change of usual effects that were not found would have been seen; empty where not computed.
    """

    SCHEMA: ClassVar[str] = "idapt.diagnosis/1"

    verdict: Verdict
    error: ErrorTable
    effects: Sequence[EffectEstimate]
    declared: Sequence[Effect]
    candidates: Sequence[RejectedCandidate]
    signature: str
    next_experiment: str
    runtime_s: float = 0.0
    explanations: Sequence[Explanation] = ()
    measurement: Measurement | None = None
    laws: LawReport | None = None
    changes: ChangeReport | None = None
    not_tried: Sequence[str] = ()
    false_discovery_rate: float | None = None
    not_named: Sequence[EffectEstimate] = ()
    splits: SplitReport | None = None
    mending: str = ""
    limits: Sequence[DetectionLimit] = ()

    def to_dict(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        return {
            "schema": self.SCHEMA,
            "verdict": self.verdict.value,
            "error": self.error.to_dict(),
            "effects": [e.to_dict() for e in self.effects],
            "declared": [e.to_dict() for e in self.declared],
            "candidates": [c.to_dict() for c in self.candidates],
            "signature": self.signature,
            "next_experiment": self.next_experiment,
            "runtime_s": self.runtime_s,
            "explanations": [e.to_dict() for e in self.explanations],
            "measurement": None if self.measurement is None else self.measurement.to_dict(),
            **({"not_tried": list(self.not_tried)} if self.not_tried else {}),
            **({"detection_limits": [x.to_dict() for x in self.limits]} if self.limits else {}),
            **self._rate(),
            **{name: r.to_dict() for name in ("laws", "changes", "splits") if (r := getattr(self, name)) is not None},
        }

    def _rate(self) -> dict[str, Any]:
        """What a false discovery rate left out."""
        if self.false_discovery_rate is None:
            return {}
        return {"false_discovery_rate": self.false_discovery_rate, "not_named": [e.to_dict() for e in self.not_named]}
