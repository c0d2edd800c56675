"""Recordings at a longer control period than they were made at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datamodules.recordings.convert import IRREGULAR, Imported
from datamodules.recordings.errors import RecordingError
from datamodules.trajectories import Episode, Trajectories


def resampled(imported: Imported, period: float) -> Imported:
    """Recordings with a step every ``period`` s: observations nearest in time, actions as they were held.

    In each step the action counts that was held where it begins; commands between are left out.

    Args:
        imported: as :func:`convert` makes it.
        period: s.

    Raises:
        RecordingError: if it is shorter than that of the recording, or no episode is so long.
    """
    recorded = imported.trajectories
    if not period >= (1 - IRREGULAR) * recorded.dt:
        raise RecordingError(
            f"--period is {period:g} s, and the recording has a row every {recorded.dt:g} s: what was between these is "
            "not known. Give a longer period"
        )
    made = [e for episode in recorded if (e := resampled_episode(episode, recorded.dt, period)) is not None]
    if not made:
        raise RecordingError(f"--period is {period:g} s, and no episode lasts as long")
    lost = len(recorded) - len(made)
    note = f"resampled from {recorded.dt:g} s: observations are the nearest in time, actions those that were held" + (
        f"; {lost} episodes are shorter than a step and left out" if lost else ""
    )
    timing = replace(
        imported.timing, dt=period, jitter=0.0, regular=True, duration=period * sum(map(len, made)),
    )  # fmt: skip
    return Imported(Trajectories(tuple(made), period, recorded.source), timing, (*imported.notes, note))


def resampled_episode(episode: Episode, dt: float, period: float) -> Episode | None:
    """An episode with a step every ``period`` s; None if it is shorter than one.

    Args:
        episode: T steps.
        dt: period of the episode, s, where it has no timestamps.
        period: s.
    """
    T = len(episode)
    times = dt * np.arange(T + 1) if episode.timestamps is None else episode.timestamps - episode.timestamps[0]
    slack = 1e-6 * dt  # what sums of periods are off by
    steps = int((times[-1] + slack) / period)
    if not steps:
        return None
    wanted = period * np.arange(steps + 1)
    held = np.searchsorted(times, wanted + slack, side="right") - 1
    after = np.minimum(held + 1, T)
    seen = np.where(times[after] - wanted < wanted - times[held] - slack, after, held)
    acts = np.minimum(held[:-1], T - 1)
    infos = {n: a[acts] if len(a) == T else a[seen] if len(a) == T + 1 else a for n, a in episode.infos.items()}
    return Episode(episode.actions[acts], {n: a[seen] for n, a in episode.observations.items()}, infos=infos)
