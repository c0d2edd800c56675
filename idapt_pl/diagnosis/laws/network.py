"""A small network for a force that no law says: a black box, fitted to what forecasts leave, tested as any effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.laws.forecasts import JointForecasts
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.learned import MEMORY_INPUTS, ResidualNetwork
from idapt_pl.estimation.least_squares import huber_weights

HIDDEN = 6
"""Hidden units."""

ROUNDS = 25
"""Steps of Levenberg and Marquardt."""

RIDGE = 3.0
"""Pull of a weight towards 0, in units of the noise."""


@dataclass(frozen=True)
class NetworkFit:
    """A network, and what it leaves of the episodes that its fit did not see, as a share; 1 where it is no use."""

    effect: ResidualNetwork
    left: float


def fit_network(context: SearchContext, state: SearchState, f: JointForecasts) -> NetworkFit:
    """Fit a network on a joint to linear forecasts; a quarter of the fitted episodes says when to stop."""
    names = [x for x in ("q", "v", f.sizes.command, "slow_v", "bent") if x]
    values = np.stack([f.values(MEMORY_INPUTS[x][1] if x in MEMORY_INPUTS else x) for x in names], -1)
    spans = np.quantile(np.abs(values.reshape(-1, len(names))), 0.98, axis=0) + 1e-6
    x = np.clip(values / spans, -1.0, 1.0)
    episodes = state.windows.fit.windows.episode
    known = np.unique(episodes)
    judged = np.isin(episodes, known[:: 4 if len(known) > 3 else 2])
    rows = np.repeat(judged, f.test.left.size // len(episodes))
    w = np.random.default_rng(context.seed).normal(size=HIDDEN * (len(names) + 2) + 1) * 0.5
    w[-HIDDEN - 1 :] = 0.0
    weights, left = train(f, x, rows, w)
    rounded = tuple(float(f"{v:.5g}") for v in weights)
    effect = ResidualNetwork(f.sizes.name, " ".join(names), tuple(float(f"{s:.5g}") for s in spans), rounded, f.torque)
    return NetworkFit(effect, left)


def train(f: JointForecasts, x: np.ndarray, judged: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, float]:
    """The weights that do best on rows that are judged (rows,) but not fitted, and the share that they leave there."""

    def effect_of(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, slope = network(x, w)
        moved = np.einsum("nrk,nkp->nrp", f.response, f.torque * np.concatenate([force[..., None], slope], -1))
        clear = f.test.clear(moved.reshape(-1, moved.shape[-1]))
        return f.test.left + clear[:, 0], clear[:, 1:]

    def loss(z: np.ndarray, rows: np.ndarray) -> float:
        return float(np.minimum(np.square(z[rows]), 36.0).sum())

    ridge = RIDGE * np.sqrt(f.test.variance) * np.eye(len(w))
    now, J = effect_of(w)
    at_first = best_loss = loss(now, judged)
    best, damping = w, 1.0
    for _ in range(ROUNDS):
        weight = huber_weights(now[~judged])[:, None] * J[~judged]
        H = J[~judged].T @ weight + ridge
        move = -np.linalg.solve(H + damping * np.diag(np.diag(H)), weight.T @ now[~judged] + ridge @ w)
        tried, slopes = effect_of(w + move)
        if loss(tried, ~judged) < loss(now, ~judged):
            w, now, J, damping = w + move, tried, slopes, damping / 3
            if loss(now, judged) < best_loss:
                best, best_loss = w, loss(now, judged)
        else:
            damping *= 5
    return best, best_loss / max(at_first, 1e-12)


def network(x: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Output (n, k) and its derivative by the weights (n, k, p), as of :class:`ResidualNetwork` with scale 1."""
    n = x.shape[-1]
    first, bias = w[: HIDDEN * n].reshape(n, HIDDEN), w[HIDDEN * n : HIDDEN * (n + 1)]
    second = w[HIDDEN * (n + 1) : HIDDEN * (n + 2)]
    h = np.tanh(x @ first + bias)
    back = second * (1 - np.square(h))
    by_first = (x[..., :, None] * back[..., None, :]).reshape(*x.shape[:-1], -1)
    return h @ second + w[-1], np.concatenate([by_first, back, h, np.ones((*x.shape[:-1], 1))], -1)
