"""Recordings at a longer control period: the nearest observations, the actions that were held."""

import numpy as np
import pytest

from datamodules import Episode, Trajectories
from datamodules.recordings import Imported, RecordingError, resampled
from datamodules.recordings.convert import Timing


def imported(T, dt, timestamps=None):
    """Episodes whose rows and actions hold their number."""
    number = np.arange(T + 1, dtype=float)
    episode = Episode(
        np.arange(T, dtype=np.float32)[:, None], {"qpos": number[:, None]}, timestamps=timestamps,
        infos={"row": number, "step": number[:-1], "file": np.zeros(3)},
    )  # fmt: skip
    return Imported(Trajectories((episode,), dt, "here"), Timing(dt, 0.0, timestamps is None, T * dt, (dt, "")))


def rows_and_actions(made):
    (episode,) = made.trajectories
    assert episode.infos["row"].tolist() == episode.observations["qpos"][:, 0].tolist()
    assert episode.infos["step"].tolist() == episode.actions[:, 0].tolist() and len(episode.infos["file"]) == 3
    return episode.observations["qpos"][:, 0].tolist(), episode.actions[:, 0].tolist()


@pytest.mark.parametrize(
    ("T", "dt", "period", "rows", "actions"),
    [
        (8, 0.01, 0.02, [0, 2, 4, 6, 8], [0, 2, 4, 6]),
        (9, 0.01, 0.02, [0, 2, 4, 6, 8], [0, 2, 4, 6]),
        (6, 0.1, 0.3, [0, 3, 6], [0, 3]),  # 0.3 is no sum of three 0.1 in floating point
        (7, 0.03, 0.04, [0, 1, 3, 4, 5, 7], [0, 1, 2, 4, 5]),  # at 0, 0.04, 0.08, 0.12, 0.16 and 0.2 s
        (3, 1 / 30, 1 / 30, [0, 1, 2, 3], [0, 1, 2]),
    ],
)
def test_a_step_has_the_nearest_row_and_the_action_that_is_held_where_it_begins(T, dt, period, rows, actions):
    made = resampled(imported(T, dt), period)
    assert rows_and_actions(made) == (rows, actions)
    assert (made.trajectories.dt, made.timing.dt, made.timing.regular) == (period, period, True)
    assert "resampled from" in made.notes[-1]


def test_irregular_rows_become_regular():
    times = np.array([5.0, 5.011, 5.019, 5.033, 5.038, 5.052])
    made = resampled(imported(5, 0.01, times), 0.02)
    assert rows_and_actions(made) == ([0, 2, 4], [0, 2]) and made.trajectories.episodes[0].timestamps is None


@pytest.mark.parametrize("period", [0.005, 0.0, -1.0, float("nan")])
def test_what_was_between_rows_is_not_made_up(period):
    with pytest.raises(RecordingError, match="what was between these is not known"):
        resampled(imported(5, 0.01), period)


@pytest.mark.parametrize("period", [0.06, float("inf")])
def test_an_episode_must_last_a_step(period):
    with pytest.raises(RecordingError, match="no episode lasts as long"):
        resampled(imported(5, 0.01), period)
