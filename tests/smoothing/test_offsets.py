"""What readings are off by throughout is found where it was planted, and nothing where nothing was."""

import numpy as np
import pytest
from test_smoothing import played

from idapt_pl.smoothing import ReadRecording, offsets, reading_offsets
from idapt_pl.smoothing.offsets import shots_of
from idapt_pl.tasks import make_task

HEIGHT, PITCH = 0, 1


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Simulations enough for clean readings."""
    monkeypatch.setattr(offsets, "MOST_SHOTS", 60)


@pytest.fixture(scope="module")
def cheetah():
    """The task, true recordings of it, and the spread of its states."""
    task = make_task("half_cheetah")
    recordings = [ReadRecording(*played(task, task.domain("source"), 40, seed)) for seed in range(6)]
    return task, recordings, np.concatenate([r.readings for r in recordings]).std(0)


def read(recordings, scale, offset, noise=0.05, begin=-1):
    rng = np.random.default_rng(0)
    return [
        ReadRecording(
            r.without(-offset * scale, begin).readings + noise * scale * rng.normal(size=r.readings.shape), r.actions
        )
        for r in recordings
    ]


def test_offsets_of_readings_are_found(cheetah):
    task, recordings, scale = cheetah
    planted = np.zeros(len(scale))
    planted[[HEIGHT, PITCH]] = 0.5, -0.4
    found, (gain, error) = reading_offsets(task, task.domain("source"), read(recordings, scale, planted), scale, 5)
    np.testing.assert_allclose(found / scale, planted, atol=0.25)
    assert found[HEIGHT] > 0.25 * scale[HEIGHT] and found[PITCH] < -0.2 * scale[PITCH] and gain > 2 * error > 0


def test_nothing_is_found_where_readings_are_right(cheetah):
    task, recordings, scale = cheetah
    found, _ = reading_offsets(task, task.domain("source"), read(recordings, scale, np.zeros(len(scale))), scale, 5)
    assert not found.any()


def test_recordings_that_are_too_short_or_too_few_have_no_offset(cheetah):
    task, recordings, scale = cheetah
    for few in (recordings[:2], [r.first(6) for r in recordings], []):
        found, gain = reading_offsets(task, task.domain("source"), few, scale, 5)
        assert not found.any() and gain == (0.0, 0.0)


def test_stretches_are_spread_over_recordings_and_stay_within_them(cheetah):
    _, recordings, _ = cheetah
    shots = shots_of(recordings, 5, 3)
    assert set(shots.recording) == set(range(6)) and shots.readings.shape[1:] == (4, 17)
    assert np.array_equal(shots.readings[0], recordings[0].readings[5:9])
    assert np.array_equal(shots.actions[0], recordings[0].actions[5:8])


def test_readings_are_freed_of_an_offset_after_the_pairs_alone(cheetah):
    _, (recording, *_), scale = cheetah
    freed = recording.without(scale, 4)
    assert np.array_equal(freed.readings[:5], recording.readings[:5])
    np.testing.assert_allclose(freed.readings[5:], recording.readings[5:] - scale)
