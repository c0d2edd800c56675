"""Trials of a policy where it trained: whether it trains again there, and whether its training is kept.

The return in the source, grounded or not, is no secret, so training may depend on it; that in the target is one.
"""

from __future__ import annotations

import copy
import logging
from contextlib import closing
from dataclasses import dataclass

from gymnasium.vector import VectorEnv

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import deterministic
from idapt_pl.rl.returns import evaluate
from idapt_pl.stage import TRAIN_AGAIN

log = logging.getLogger(__name__)
A_TENTH = 0.1
"""Share of the source policy's return in the source; a policy that lacks more in the grounded source falls short."""


def trial(policy: AsymmetricSAC, env: VectorEnv, episodes: int) -> float:
    """Mean return (or success) of a policy with its mean action; closes the environment."""
    with closing(env):
        return evaluate(env, deterministic(policy), episodes, seed=0).mean


@dataclass(frozen=True)
class GroundedTrials:
    """Judges the training of a policy in the grounded source by episodes there.

    Attributes:
        episodes: how many.
        repeats: how often a policy that falls short may train again, as long as before.
        in_source: mean return (or success) of the source's policy in the source; None where it is not known.
    """

    episodes: int
    repeats: int
    in_source: float | None

    def __call__(
        self, policy: AsymmetricSAC, before: AsymmetricSAC, envs: tuple[VectorEnv, VectorEnv], attempt: int
    ) -> dict:
        """Compare a policy with what it was before its training, after so many attempts.

        Where neither does nearly as well as the source's policy in the source, it shall train again: what the policy
        learned so far stays, and ``TRAIN_AGAIN`` is among the notes. Else, or after the last attempt, it is put back if
        it was better before: SAC can unlearn, one that holds still for long forgets what to do when it does not.

        Returns:
            ``trial_before``, ``trial_after``: mean returns; ``attempts``; ``kept``, which of both policies.
        """
        tried = (copy.deepcopy(before).to(policy.device), policy)
        means = [trial(p, env, self.episodes) for p, env in zip(tried, envs, strict=True)]
        told = {"trial_before": means[0], "trial_after": means[1], "attempts": attempt}
        if attempt <= self.repeats and self.falls_short(max(means)):
            words = "the policy trains again: %.1f in the grounded source, %.1f in the source"
            log.info(words, max(means), self.in_source)
            return told | {TRAIN_AGAIN: True}
        if means[0] > means[1]:
            policy.load_state_dict(before.state_dict())
            log.info("the policy is kept as it was: %.1f in the grounded source, after more training %.1f", *means)
        return told | {"kept": "before" if means[0] > means[1] else "after"}

    def falls_short(self, mean: float) -> bool:
        """Whether a return in the grounded source is more than a tenth below that of the source's policy there."""
        return self.in_source is not None and mean < self.in_source - A_TENTH * abs(self.in_source)
