"""How probable the explanations are that recordings leave, one against another and against all that nobody tried."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

RESAMPLINGS = 2000
"""Of the Bayesian bootstrap."""

TEMPERATURE = 2.0
"""Windows count as so many times fewer: what is wrong with the noise's model is wrong in all of them."""

PER_PARAMETER = 0.5
"""Nats by which an explanation is less probable beforehand for each further parameter."""

RARE = 1.5
"""The same for each effect that is rare on machines (:data:`~idapt_pl.effects.plausible.RARITY`)."""

HALF_UNEXPLAINED = 1.0
"""Held-out loss above the noise at which it is as probable as not that something else is missing."""

NEVER_SURE = 0.05
"""Probability of something else where nothing is left to explain."""


def probabilities(
    losses: Sequence[np.ndarray], rows: int, parameters: Sequence[int], rare: Sequence[int], seed: int = 0
) -> np.ndarray:
    """Posterior probabilities of explanations; what they lack to 1 is that of something else.

    Pseudo-BMA with the Bayesian bootstrap (pseudo-BMA+, Yao et al. 2018): weights by what each says of held-out
    windows, averaged over resampled windows, so that an advantage that comes from few of them counts little.

    Args:
        losses: of every explanation in the same held-out windows, mean squares in units of the noise, (n,) each.
        rows: residuals in a window.
        parameters: number of each explanation.
        rare: number of effects that are rare on machines, of each.
        seed: of the bootstrap.

    Returns:
        (explanations,).
    """
    scores = -0.5 * rows * np.stack(list(losses)) / TEMPERATURE
    prior = -PER_PARAMETER * np.asarray(parameters) - RARE * np.asarray(rare)
    n = scores.shape[1]
    draws = n * np.random.default_rng(seed).dirichlet(np.ones(n), RESAMPLINGS)
    totals = draws @ (scores - scores[0]).T + prior
    weights = np.exp(totals - totals.max(1, keepdims=True))
    among = (weights / weights.sum(1, keepdims=True)).mean(0)
    left = max(min(float(np.mean(x)) for x in losses) - 1.0, 0.0)
    other = max(left / (left + HALF_UNEXPLAINED), NEVER_SURE)
    return (1.0 - other) * among
