"""Is a new F better than the one before? Judged on held-out images and actions of the target, never on its reward.

A policy is rolled out in the grounded source with the one F and with the other, and its transitions (f, a, f') are
compared with those it made in the target and that neither F was fitted to. The features f are those of the
policy's encoder, so this works for every task. The distance is the energy distance of (f, a, u), u what f' differs by
from a linear law of the target: most of a change follows from f alone, and would hide what the actions do. Whole pieces
of recordings are drawn again (bootstrap), since transitions within one go together; of the grounded source, where
there is no shortage, whole episodes of several rollouts.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from datamodules.pieces import held_out, pieces
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.rl.transition_distance import ROLLOUTS, grounded_rollouts, standardised_transitions
from idapt_pl.stage import Stages
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)
BOOTSTRAP_DRAWS = 2000
"""Bootstrap draws."""


@dataclass(frozen=True)
class TransitionSample:
    """Transitions and where they come from.

    Attributes:
        values: standardised (f, a, u), (n, 2d + nu).
        piece: number of each one's piece (or episode), 0 to p - 1, (n,).
    """

    values: torch.Tensor
    piece: np.ndarray

    @property
    def membership(self) -> torch.Tensor:
        """One where a transition belongs to a piece, (n, p)."""
        return torch.nn.functional.one_hot(torch.from_numpy(self.piece)).float()

    def mean_distance(self, other: TransitionSample, w: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Mean distance between transitions of different pieces, for weights of the pieces (b, p), (b, q): (b,)."""
        mine, theirs = self.membership, other.membership
        sums = mine.T @ torch.cdist(self.values, other.values) @ theirs  # (p, q)
        pairs = mine.sum(0)[:, None] * theirs.sum(0)
        if other is self:
            sums, pairs = sums.fill_diagonal_(0), pairs.fill_diagonal_(0)
        return ((w @ sums) * v).sum(1) / ((w @ pairs) * v).sum(1)


def unpredicted_change(known: torch.Tensor, d: int) -> Callable[[torch.Tensor], torch.Tensor]:
    """(f, a, change of f) to (f, a, u): u is what a linear law does not predict, in units of its spread.

    The map can be inverted, so distributions agree after it if and only if they did before.

    Args:
        known: standardised transitions (n, 2d + nu) that the law is fitted to, by ridge regression.
        d: size of f.
    """

    def inputs(x: torch.Tensor) -> torch.Tensor:
        return torch.cat([x[:, :-d], torch.ones(len(x), 1)], 1)

    A = inputs(known)
    law = torch.linalg.solve(A.T @ A + torch.eye(A.shape[1]), A.T @ known[:, -d:])
    spread = (known[:, -d:] - A @ law).std(0).clamp(min=1e-3)
    return lambda x: torch.cat([x[:, :-d], (x[:, -d:] - inputs(x) @ law) / spread], 1)


@dataclass(frozen=True)
class RollbackDecision:
    """Whether a new F is clearly worse than the one before.

    Attributes:
        before: energy distance to the held-out target transitions with the F before.
        after: with the new one.
        worse_by: their difference.
        ci95: its 95 % interval, by bootstrap.
        rolled_back: whether all of that interval is above zero.
        held_out_pieces: pieces of recordings that were held out.
        held_out_steps: control steps in them.
    """

    before: float
    after: float
    worse_by: float
    ci95: tuple[float, float]
    rolled_back: bool
    held_out_pieces: int = 0
    held_out_steps: int = 0

    def to_dict(self) -> dict:
        """As in ``selection.json``."""
        return vars(self) | {"ci95": list(self.ci95)}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> RollbackDecision:
        """From ``selection.json``, whatever else it holds."""
        known = {f.name: entry[f.name] for f in dataclasses.fields(cls) if f.name in entry}
        return cls(**known | {"ci95": tuple(known["ci95"])})

    @property
    def sentence(self) -> str:
        """The decision in words."""
        low, high = self.ci95
        told = "F is rolled back: it is clearly worse" if self.rolled_back else "F is kept: it is not clearly worse"
        return (
            f"{told} than the one before on {self.held_out_steps} held-out target steps; residual "
            f"{self.after:.3g} against {self.before:.3g}, difference {self.worse_by:+.3g} "
            f"(95 %: {low:+.3g} to {high:+.3g})"
        )


@dataclass(frozen=True)
class Rollback:
    """Goes on with the F of the step before where the target's held-out images and actions say so; off by default.

    Attributes:
        worlds: of the run; no target is made.
        stages: of the run; keeps the decision in ``selection.json``.
        on: whether anything is compared at all.
    """

    worlds: Worlds
    stages: Stages
    on: bool

    def __call__(
        self, k: int, target: Path, G: VisualTransformation, F: ActionTransformation | None,
        F_before: ActionTransformation | None, pi: AsymmetricSAC,
    ) -> ActionTransformation | None:  # fmt: skip
        """The F to go on with; ``pi`` is the policy whose recording ``target`` is."""
        if not self.on or F is None or F is F_before:
            return F

        def make(seed: int) -> dict:
            return compare_transformations(self.worlds, pi, G, F, F_before, target, seed).to_dict()

        decision = RollbackDecision.from_dict(self.stages.measure(k, "selection", make))
        log.info("step %d  %s", k, decision.sentence)
        return F_before if decision.rolled_back else F


def compare_transformations(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation,
    F_before: ActionTransformation | None, target: Path, seed: int,
) -> RollbackDecision:  # fmt: skip
    """The grounded source with a new F against that with the one before.

    Args:
        worlds: of the run; no target is made.
        policy: whose target recordings these are.
        G: the visual transformation.
        F: the new action transformation, in whose features transitions are compared.
        F_before: the one to fall back to; None is the identity.
        target: trajectory file; its images and actions are all that is used.
        seed: of the rollouts and of the bootstrap.

    Raises:
        ValueError: if too little was held out.
    """
    stacks = FrameStacks(read_all([target]), worlds.frame_stack)
    values, piece = standardised_transitions(stacks, F), pieces(stacks)[stacks.transitions]
    out = held_out(piece)
    if len(np.unique(piece[out])) < 2:
        raise ValueError(f"schedule.rollback needs at least 10 target interactions in a grounding step, got {len(out)}")
    describe = unpredicted_change(values[torch.from_numpy(~out)], F.encoder.features)
    real = TransitionSample(describe(values[torch.from_numpy(out)]), np.unique(piece[out], return_inverse=True)[1])
    before, after = (
        grounded_sample(worlds, policy, G, transform, F, describe, len(out), ROLLOUTS, seed)
        for transform in (F_before, F)
    )
    return bootstrap_comparison(before, after, real, seed)


def grounded_sample(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None,
    scale: ActionTransformation, describe: Callable[[torch.Tensor], torch.Tensor], steps: int, rollouts: int, seed: int,
) -> TransitionSample:  # fmt: skip
    """Transitions of the grounded source, whole episodes as pieces.

    Args:
        worlds: of the run.
        policy: that acts.
        G: the visual transformation.
        F: the action transformation that is rolled out; None is the identity.
        scale: the one in whose features and units transitions are compared.
        describe: of standardised transitions.
        steps: control steps of a rollout.
        rollouts: how many.
        seed: of the rollouts.
    """
    played = grounded_rollouts(worlds, policy, G, F, steps, rollouts, seed)
    begins = [(i, first) for i, r in enumerate(played) for first in r.first[r.transitions]]
    episode = np.unique(begins, axis=0, return_inverse=True)[1].ravel()
    return TransitionSample(describe(torch.cat([standardised_transitions(r, scale) for r in played])), episode)


def bootstrap_comparison(
    before: TransitionSample, after: TransitionSample, real: TransitionSample, seed: int
) -> RollbackDecision:
    """Whether ``after`` is clearly further from ``real`` than ``before`` is; see :func:`compare_transformations`."""
    one, other = distance_draws(real, [before, after], seed)
    worse = other - one
    low, high = np.nanquantile(worse[1:].numpy(), [0.025, 0.975])  # a draw of one piece alone has no spread: NaN
    return RollbackDecision(
        before=round(float(one[0]), 4),
        after=round(float(other[0]), 4),
        worse_by=round(float(worse[0]), 4),
        ci95=(round(float(low), 4), round(float(high), 4)),
        rolled_back=bool(low > 0),
        held_out_pieces=int(real.piece.max()) + 1,
        held_out_steps=len(real.values),
    )


def distance_draws(real: TransitionSample, samples: Sequence[TransitionSample], seed: int) -> list[torch.Tensor]:
    """Energy distance of each sample to ``real``, (1 + BOOTSTRAP_DRAWS,): first as they are, then with pieces redrawn.

    The draws of ``real`` are common to all. Pairs within a piece are left out, so that samples alike are at 0.
    """
    rng = np.random.default_rng(seed)

    def weights(sample: TransitionSample) -> torch.Tensor:
        """How often each piece is drawn; the first row is the sample as it is."""
        p = sample.piece.max() + 1
        draws = rng.multinomial(p, np.full(p, 1 / p), BOOTSTRAP_DRAWS)
        return torch.from_numpy(np.concatenate([np.ones((1, p)), draws])).float()

    v = weights(real)
    spread = real.mean_distance(real, v, v)

    def distance(sample: TransitionSample) -> torch.Tensor:
        w = weights(sample)
        return 2 * sample.mean_distance(real, w, v) - sample.mean_distance(sample, w, w) - spread

    return [distance(sample) for sample in samples]
