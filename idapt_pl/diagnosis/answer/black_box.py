"""How much of a residual a black box could predict: a ridge regression on state and commands."""

from __future__ import annotations

import numpy as np

from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_windows import SearchWindows
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.simulator import Effects, Simulator

RIDGES = (1.0, 10.0, 100.0)
"""Strengths tried, in units of the root of the number of windows."""


def predictable_share(context: SearchContext, windows: SearchWindows, effects: Effects, held_out: np.ndarray) -> float:
    """Share of the held-out squared error that a ridge regression predicts (R²); the best of a few strengths.

    Args:
        context: of the search.
        windows: fitted and held out.
        effects: of the model.
        held_out: whitened residuals of the held-out windows, (n, rows).
    """
    fitted = context.whitened(windows.fit, effects)
    X = black_box_features(context.sim, join_windows(windows.fit.windows, windows.held_out.windows))
    A, B = X[: len(fitted)], X[len(fitted) :]
    target, left = np.clip(fitted, -6, 6), np.clip(held_out, -6, 6)
    scores = []
    for strength in RIDGES:
        H = A.T @ A + strength * len(A) ** 0.5 * np.eye(A.shape[1])
        predicted = B @ np.linalg.solve(H, A.T @ (target - target.mean(0))) + target.mean(0)
        scores.append(1.0 - np.square(left - predicted).mean() / max(np.square(left).mean(), 1e-12))
    return float(max(scores))


def join_windows(a: Windows, b: Windows) -> Windows:
    """Windows of the same length, one after the other."""
    return Windows(np.concatenate([a.episode, b.episode]), np.concatenate([a.start, b.start]), a.offsets)


def black_box_features(sim: Simulator, windows: Windows) -> np.ndarray:
    """What a black box may know of a window: first state, mean commands, their squares and signs, (n, features)."""
    rows = []
    for e, s in zip(windows.episode, windows.start, strict=True):
        r = sim.data[e]
        actions = r.actions[s : s + windows.offsets[-1]]
        half = len(actions) // 2
        means = actions[: half or 1].mean(0), actions[half:].mean(0)
        rows.append(np.concatenate([r.qpos[s], r.qvel[s], *means, r.actions[max(s - 1, 0)]]))
    X = np.stack(rows)
    spread = X.std(0)
    X = (X - X.mean(0))[:, spread > 1e-9] / spread[spread > 1e-9]
    X = np.clip(X, -4, 4)
    return np.concatenate([X, np.square(X) - 1, np.tanh(3 * X), np.sin(2 * X)], 1)
