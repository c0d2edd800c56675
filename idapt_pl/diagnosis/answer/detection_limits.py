"""How small a change of the usual effects would have been seen: what "no missing effect" means for these recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from idapt_pl.diagnosis.rounds.screening import ScoreTest
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.actuators import ActuatorGain, ActuatorKp
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.effects.wording import unit_at
from idapt_pl.prediction.force_windows import judges_forces

USUALLY_OFF: tuple[type[Effect], ...] = (
    ActuatorGain, ActuatorKp, ActuatorDelay, BodyMass, JointDamping, JointFrictionloss, JointArmature,
)  # fmt: skip
"""What is off on nearly every machine."""

SHARES = tuple(kind.name for kind in (ActuatorGain, ActuatorKp, BodyMass))
"""Of these the effects of which one speaks in per cents."""

SURELY_SEEN = 2.0
"""Times the change that removes just as much of the held-out error as is asked of an effect."""


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest change of one parameter that the recordings would have shown.

    Attributes:
        effect: its name.
        target: MJCF name of what it acts on.
        parameter: that changes.
        nominal: its value in the model.
        change: the smallest that shows, either way; infinite where none would.
        unit: of both.
    """

    effect: str
    target: str
    parameter: str
    nominal: float
    change: float
    unit: str

    @property
    def told_as_share(self) -> bool:
        """Whether it is best told as a share of the model's value, as of masses and gains."""
        return self.effect in SHARES and self.nominal != 0

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``; ``change`` is null where none would show."""
        change = self.change if np.isfinite(self.change) else None
        return {
            "effect": self.effect, "target": self.target, "parameter": self.parameter, "nominal": self.nominal,
            "change": change, "unit": self.unit,
        }  # fmt: skip


def detection_limits(context: SearchContext, state: SearchState) -> tuple[DetectionLimit, ...]:
    """Of every usual effect that was not found, on one joint, motor or body each; nothing where forces are judged.

    What a change does to predictions, beside what was found, is taken to be linear. It must remove a share of the
    held-out error, and be more than noise makes of it.
    """
    split = state.windows.scout
    if judges_forces(split):
        return ()
    screen = ScoreTest(context, state, split, context.coarse_step(split, state.effects), context.responses)
    level = float(context.loss(state.windows.held_out, state.effects).mean())
    least = max(context.settings.relative_gain * level, context.settings.z**2 * screen.variance / screen.left.size)

    def limit(c: Candidate) -> DetectionLimit:
        begin, change = screen.standing(c)
        one = c if c.size == 1 else c.with_one_free(0, c.nominal)
        slope = screen.clear(screen.derivative(one, begin[:1], at_x=change))[:, 0]
        rms = float(np.sqrt(np.square(slope).mean()))
        seen = SURELY_SEEN * c.scale[0] * np.sqrt(least) / rms if rms > 1e-9 else np.inf
        unit = unit_at(context.sim.model, c.target, c.units()[0])
        return DetectionLimit(c.kind.name, c.target, c.names[0], float(c.nominal[0]), float(f"{seen:.3g}"), unit)

    return tuple(context.sim.side_by_side.map(limit, usual_ones(context.candidates, state)))


def usual_ones(candidates: Sequence[Candidate], state: SearchState) -> list[Candidate]:
    """Candidates of usual effects that were not found, each on its own joint, motor or body."""
    found = {(c.label, c.names) for c in state.candidates}
    own = [
        c for c in candidates if c.kind in USUALLY_OFF and (c.kind is ActuatorDelay) == (c.target in ("*", ACTUATED))
    ]
    return [c for c in own if (c.label, c.names) not in found]
