"""Stretches found from the recordings: where short forecasts fail in a row, far beyond the rest.

It is the model with what was found missing that forecasts, so that an effect that shows only now and then (a limit, a
contact) has its chance first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.simulator import Effects, Simulator
from idapt_pl.stretches.stretch import ForecastErrors, Stretch, runs_of

FORECAST = 0.04, 0.2
"""Seconds that a forecast lasts: where velocities were measured, and where they are slopes of positions."""

FEWEST_STEPS = 2, 5
"""Control steps that it lasts at least, likewise."""

MOST_FORECASTS = 20_000
"""Forecasts of a recording; of longer ones they begin further apart."""

USUAL_SHARE = 0.8
"""The usual error of a channel is such that this share of the forecasts has less: contacts and switches are in it."""

FAR, NEAR = 6.0, 3.0
"""Errors, in usual ones, in the middle of a stretch, and at its edges."""

TAIL = 0.99
"""A stretch is also worse than this quantile of the rest: contacts make spikes."""

SHORTEST_STRETCH, FEWEST_FORECASTS = 0.2, 5
"""A stretch lasts so many seconds, and forecasts in a row, at least; a contact or a switch is over sooner."""

LONGEST_GAP, SHARE_FAR = 0.1, 0.7
"""Forecasts within a stretch may be good by chance, so many seconds in a row; this share of them must be far off."""

LARGEST_SHARE = 0.3
"""Of a recording; if more fails, the model does."""


def forecast_errors(sim: Simulator, effects: Effects) -> tuple[list[np.ndarray], list[np.ndarray], int, np.ndarray]:
    """Errors of forecasts all along the recordings.

    Returns:
        Of each episode the steps where forecasts begin, (n,), and their errors, absolute, (n, channels); how many
        steps they last; and the usual error of each channel by what is not left out, (channels,).
    """
    slow = not sim.velocities
    steps = max(FEWEST_STEPS[slow], round(FORECAST[slow] / sim.control_period))
    total = sum(map(len, sim.data))
    stride = max(1, steps // 2, -(-total // MOST_FORECASTS))
    starts = [np.arange(0, max(len(r) - steps + 1, 0), stride) for r in sim.data]
    errors, kept = [], []
    for e, at in enumerate(starts):
        windows = Windows(np.full(len(at), e), at, np.array([steps]))
        residual = sim.residual(effects, windows)[:, 0] if len(at) else np.zeros((0, len(sim.channels)))
        errors.append(np.abs(residual[:, sim.compared]))
        left_out = sim.data[e].left_out
        kept.append(errors[-1] if left_out is None else errors[-1][~touched(left_out, at, steps)])
    every = np.concatenate(kept)
    usual = np.quantile(every, USUAL_SHARE, axis=0) / 1.28 if len(every) else np.ones(int(sim.compared.sum()))
    return starts, errors, steps, usual + 1e-9


def touched(marked: np.ndarray, starts: np.ndarray, steps: int) -> np.ndarray:
    """Whether forecasts that begin at ``starts`` go through marked steps, (n,) bool."""
    total = np.concatenate([[0], np.cumsum(marked)])
    return total[np.minimum(starts + steps, len(marked))] > total[starts]


def find_stretches(sim: Simulator, effects: Effects) -> tuple[list[Stretch], tuple[ForecastErrors, ...]]:
    """Stretches in which a model cannot hold; none where it fails in too much of the recording.

    Args:
        sim: of the nominal model, with the recordings. What is left out of them already is judged like the rest, but
            says nothing of what is usual.
        effects: of the model.

    Returns:
        The stretches, and the errors along each episode.
    """
    starts, errors, steps, usual = forecast_errors(sim, effects)
    worst = [(e / usual).max(1) if len(e) else np.zeros(0) for e in errors]
    shown = tuple(ForecastErrors(r.time[at] - r.time[0], w) for r, at, w in zip(sim.data, starts, worst, strict=True))
    tail, found = 0.0, list[Stretch]()
    for _ in range(3):  # what is found no longer counts among the rest
        threshold = max(FAR, tail)
        before, found = found, []
        for e, (r, at, error) in enumerate(zip(sim.data, starts, errors, strict=True)):
            found += stretches_of(e, r, at, error / usual, steps, threshold, channels_of(sim))
        rest = [w[~within(found, e, at)] for e, (at, w) in enumerate(zip(starts, worst, strict=True))]
        tail = float(np.quantile(np.concatenate(rest), TAIL)) if sum(map(len, rest)) else np.inf
        if found == before:
            break
    share = sum(s.last - s.first for s in found) / max(sum(map(len, sim.data)), 1)
    return (found if share <= LARGEST_SHARE else []), shown


def channels_of(sim: Simulator) -> list[str]:
    """Names of the channels that are compared."""
    return [n for n, c in zip(sim.channels, sim.compared, strict=True) if c]


def within(found: Sequence[Stretch], episode: int, starts: np.ndarray) -> np.ndarray:
    """Whether forecasts of an episode begin in one of its stretches, (n,) bool."""
    inside = np.zeros(len(starts), bool)
    for s in found:
        if s.episode == episode:
            inside |= (starts >= s.first) & (starts < s.last)
    return inside


def stretches_of(
    episode: int, record: Recording, starts: np.ndarray, error: np.ndarray, steps: int, threshold: float,
    channels: Sequence[str],
) -> list[Stretch]:  # fmt: skip
    """Stretches of one episode.

    Args:
        episode: its number.
        record: the episode.
        starts: steps where forecasts begin, (n,).
        error: in usual ones, (n, channels).
        steps: that a forecast lasts.
        threshold: error in the middle of a stretch.
        channels: their names.
    """
    if not len(starts):
        return []
    since, worst = record.time - record.time[0], error.max(1)
    late_enough = since[starts] >= record.start_up  # what was commanded before may act until then
    apart = float(np.median(np.diff(since[starts]))) if len(starts) > 1 else np.inf
    marked = np.zeros(len(starts), bool)
    for a, b in runs_of(without_short_gaps(worst > threshold, int(LONGEST_GAP / apart + 1e-6)) & late_enough):
        far = float(np.mean(worst[a:b] > threshold))
        if b - a < FEWEST_FORECASTS or (b - a) * apart < SHORTEST_STRETCH - 1e-9 or far < SHARE_FAR:
            continue
        while a > 0 and worst[a - 1] > NEAR and late_enough[a - 1]:
            a -= 1
        while b < len(worst) and worst[b] > NEAR:
            b += 1
        marked[a:b] = True
    found = []
    for a, b in runs_of(marked):
        first, last = int(starts[a]), int(min(starts[b - 1] + steps, len(record)))
        mean = np.median(error[a:b], 0)
        order = [int(i) for i in np.argsort(-mean)[:3] if mean[i] > 0.3 * mean.max()]
        told, size = tuple(channels[i] for i in order), float(np.median(worst[a:b]))
        found.append(Stretch(episode, first, last, float(since[first]), float(since[last]), size, told))
    return found


def without_short_gaps(high: np.ndarray, longest: int) -> np.ndarray:
    """Marks (n,) with gaps between them closed that are no longer than this."""
    closed = high.copy()
    for a, b in runs_of(~high):
        if a > 0 and b < len(high) and b - a <= longest:
            closed[a:b] = True
    return closed
