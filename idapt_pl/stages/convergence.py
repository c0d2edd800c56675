"""Is there anything left to learn of how the target moves? Judged on its images and actions, never on its reward.

The grounded source is compared with a new recording of the target in two ways, and one of them suffices. The energy
distance of their transitions (:mod:`~idapt_pl.stages.rollback`) may be at its floor, zero within what drawing pieces
of the recordings anew makes of it. Or, where states are positions and velocities, no law of the actions forecasts what
was recorded clearly better than the actions as they were (:mod:`~idapt_pl.stages.trajectory_matching`): what is left is
then how images are read and not how things move, and F would learn to make up for that.
"""

from __future__ import annotations

import copy
import dataclasses
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.on_policy import target_transitions
from datamodules.pieces import pieces
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.rl.transition_distance import ROLLOUTS, standardised_transitions
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.dynamics import seen_states
from idapt_pl.stages.rollback import TransitionSample, distance_draws, grounded_sample, unpredicted_change
from idapt_pl.stages.trajectory_matching import CLEARLY_BETTER, held_out_remainders

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Convergence:
    """Whether a new recording of the target shows anything that the grounded source does not do already.

    Attributes:
        residual: energy distance between their transitions, 0 where they are alike.
        ci95: its 95 % interval, by bootstrap.
        remainders: robust scale of what action laws leave of held-out recordings, m or rad, the first of them the
            actions as they are; empty where states are no positions and velocities.
        settled: whether nothing is left to learn.
    """

    residual: float
    ci95: tuple[float, float]
    remainders: tuple[float, ...]
    settled: bool

    def to_dict(self) -> dict:
        """As in ``convergence.json``."""
        return vars(self) | {"ci95": list(self.ci95), "remainders": list(self.remainders)}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Convergence:
        """From ``convergence.json``, whatever else it holds."""
        known = {f.name: entry[f.name] for f in dataclasses.fields(cls)}
        return cls(**known | {"ci95": tuple(known["ci95"]), "remainders": tuple(known["remainders"])})

    @property
    def sentence(self) -> str:
        """The decision in words."""
        low, high = self.ci95
        told = "nothing is left to learn" if self.settled else "there is something left to learn"
        text = (
            f"{told} of how the target moves: the energy distance of its transitions is {self.residual:.3g} "
            f"(95 %: {low:.3g} to {high:.3g}; 0 where they are alike)"
        )
        if self.remainders:
            better = self.remainders[0] / max(min(self.remainders), 1e-12)
            text += (
                f", and forecasts with the best law of actions err {better:.3g} times less than with actions as they "
                f"are ({CLEARLY_BETTER:g} times is clear)"
            )
        return text


def check_convergence(
    c: StageContext, k: int, pi: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None,
    target: Sequence[Path],
) -> Convergence:  # fmt: skip
    """Compare the grounded source with the newest recording of the target; the result is kept in ``convergence.json``.

    Args:
        c: of the run; no target is made.
        k: grounding step.
        pi: the policy that recorded.
        G: shows the source as the target.
        F: transforms actions; None is the identity.
        target: trajectory files of the target, the newest last; images and actions are all that is used.
    """

    def make(seed: int) -> dict:
        scale = c.make.dynamics(encoder=copy.deepcopy(pi.actor.encoder), **c.worlds.action_bounds)
        scale.standardise(target_transitions(target[-1:], scale.encode, c.worlds.frame_stack))
        draws = residual_draws(c, pi, G, F, scale, target[-1], seed)
        low, high = np.nanquantile(draws[1:], [0.025, 0.975])
        left = law_remainders(c, scale, target) if F is None else ()
        at_floor = bool(low <= 0)
        no_law = bool(left) and left[0] <= CLEARLY_BETTER * min(left)
        found = Convergence(
            round(float(draws[0]), 4), (round(float(low), 4), round(float(high), 4)), left, at_floor or no_law
        )
        return found.to_dict()

    found = Convergence.from_dict(c.stages.measure(k, "convergence", make))
    log.info("step %d  %s", k, found.sentence)
    return found


def residual_draws(
    c: StageContext, pi: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None,
    scale: ActionTransformation, target: Path, seed: int,
) -> np.ndarray:  # fmt: skip
    """Energy distance between grounded transitions and the target's, then of bootstrap draws of both."""
    stacks = FrameStacks(read_all([target]), c.worlds.frame_stack)
    values, piece = standardised_transitions(stacks, scale), pieces(stacks)[stacks.transitions]
    describe = unpredicted_change(values, scale.encoder.features)
    real = TransitionSample(describe(values), np.unique(piece, return_inverse=True)[1])
    grounded = grounded_sample(c.worlds, pi, G, F, scale, describe, len(values), ROLLOUTS, seed)
    return distance_draws(real, [grounded], seed)[0].numpy()


def law_remainders(c: StageContext, scale: ActionTransformation, target: Sequence[Path]) -> tuple[float, ...]:
    """What action laws leave of held-out recordings; empty where states are no positions and velocities."""
    model = c.worlds.source_domain.compile()
    encoder = scale.encoder
    if not isinstance(encoder, PixelStatePredictor) or model.nq + model.nv != encoder.features:
        return ()
    files = [target[0], *target[-1:]] if len(target) > 1 else list(target)
    states, actions, first = seen_states(c, scale, files)
    source = c.worlds.source_domain
    left = held_out_remainders(scale, c.worlds.task, source, states, actions, first, c.batches.garat_ridge)
    return tuple(round(float(value), 8) for value in left)
