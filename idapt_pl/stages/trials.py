"""Trials of a policy where it trained: whether it trains again there, and whether its training is kept.

The return in the source, grounded or not, is no secret, so training may depend on it; that in the target is one.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from contextlib import closing

from gymnasium.vector import VectorEnv

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.flickering import FlickeringPolicy
from idapt_pl.rl.returns import evaluate
from idapt_pl.stage import TRAIN_AGAIN

log = logging.getLogger(__name__)
A_TENTH = 0.1
"""Share of the source policy's return in the source; a policy that lacks more in the grounded source falls short."""


def trial(policy: AsymmetricSAC, env: VectorEnv, episodes: int) -> float:
    """Mean return (or success) of a policy with its mean action and its flicker; closes the environment."""
    with closing(env):
        return evaluate(env, FlickeringPolicy(policy, env.num_envs, seed=0), episodes, seed=0).mean


class GroundedTrials:
    """Judges the training of a policy in the grounded source by episodes there.

    Args:
        episodes: how many.
        repeats: how often a policy that falls short may train again, as long as before.
        in_source: mean return (or success) of the source's policy in the source; None where it is not known.
    """

    def __init__(self, episodes: int, repeats: int, in_source: float | None) -> None:
        self.episodes, self.repeats, self.in_source = episodes, repeats, in_source
        if repeats and in_source is None:
            log.warning("feeding.trial_repeats does nothing: no policy was trained and tried in the source by SAC")
        self._tried: list[tuple[float, dict]] = []  # mean and weights before, and after each attempt

    def __call__(
        self, policy: AsymmetricSAC, before: AsymmetricSAC, make_env: Callable[[], VectorEnv], attempt: int
    ) -> dict:
        """Compare a policy with what it was before its training, and with earlier attempts.

        Where none does nearly as well as the source's policy in the source, it shall train again, from the best
        attempt: ``TRAIN_AGAIN`` is among the notes. Else, or after the last attempt, the best of all is kept, also if
        that is what it was before: SAC can unlearn, one that holds still for long forgets what to do when it does not.

        Returns:
            ``trial_before``, ``trial_after``: mean returns before, and of the last attempt; ``trial_kept``;
            ``attempts``; ``kept``: ``before``, ``after`` or, of several attempts, which one if not the last.
        """
        if not self._tried:
            self._try(copy.deepcopy(before).to(policy.device), make_env())
        self._try(policy, make_env())
        means = [mean for mean, _ in self._tried]
        told = {"trial_before": means[0], "trial_after": means[-1], "attempts": attempt}
        if attempt <= self.repeats and self.falls_short(max(means)):
            words = "the policy trains again: %.1f in the grounded source, %.1f in the source"
            log.info(words, max(means), self.in_source)
            policy.load_state_dict(self._tried[latest_best(means[1:]) + 1][1])
            return told | {TRAIN_AGAIN: True}
        best = latest_best(means)
        policy.load_state_dict(self._tried[best][1])
        if best < attempt:
            words = "the policy is kept as it was %s: %.1f in the grounded source, after more training %.1f"
            log.info(words, f"after attempt {best}" if best else "before", means[best], means[-1])
        kept = "before" if not best else "after" if best == attempt else f"attempt {best}"
        return told | {"trial_kept": means[best], "kept": kept}

    def _try(self, policy: AsymmetricSAC, env: VectorEnv) -> None:
        """Play a policy, and note what it was."""
        self._tried.append((trial(policy, env, self.episodes), copy.deepcopy(policy.state_dict())))

    def falls_short(self, mean: float) -> bool:
        """Whether a return in the grounded source is more than a tenth below that of the source's policy there."""
        return self.in_source is not None and mean < self.in_source - A_TENTH * abs(self.in_source)


def latest_best(means: list[float]) -> int:
    """The number of the largest, the latest of several."""
    return max(range(len(means)), key=lambda i: (means[i], i))
