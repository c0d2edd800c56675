"""An effect that few held-out windows show is judged on the others as well, by a fit that has not seen them."""

from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.rounds.both_ways import gain_on_all
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

END = Candidate(JointRange, "hip", ("lower",), (-9.0,), (0.1,))
HELD_OUT, FITTED = 30, 90


def split(n, first):
    windows = Windows(first + np.repeat(np.arange(n // 10), 10), np.arange(n), np.array([1]))
    return WhitenedWindows(windows, np.zeros((n, 1, 1)))


def search(shown, other_way):
    """Windows that lose 50 where the stop shows and a model has it not at -1; ``other_way``: what a fit finds there."""
    held_out, fit = split(HELD_OUT, 0), split(FITTED, 3)
    shows = {id(held_out): np.arange(HELD_OUT) < shown, id(fit): np.arange(FITTED) % 9 == 0}
    asked = []

    def loss(windows, effects):
        right = any(e.lower == -1.0 for e in effects)
        return 1.0 + 50.0 * (shows[id(windows)] & (not right))

    def fitted(windows, fixed, candidates, x, steps):
        asked.append(windows)
        return SimpleNamespace(x=[np.array([other_way])])

    state = SimpleNamespace(fixed=(), windows=SimpleNamespace(held_out=held_out, fit=fit))
    context = SimpleNamespace(loss=loss, fit=fitted)
    losses = loss(held_out, ()), loss(held_out, effects_of([END], [np.array([-1.0])]))
    gained = gain_on_all(context, state, [END], [np.array([-1.0])], (), losses, sure=2.0)
    return gained, [w is held_out for w in asked]


def test_what_one_window_shows_is_looked_for_in_the_windows_of_the_fit():
    (gain, error), asked = search(shown=1, other_way=-1.0)
    assert asked == [True], "fitted to the held-out windows"
    assert gain == pytest.approx(50 * 11 / 120) and gain > 2 * error


def test_what_a_fit_to_the_held_out_windows_does_not_find_stays_unsure():
    (gain, error), asked = search(shown=1, other_way=-0.5)
    assert asked == [True] and 0 < gain < 2 * error


def test_what_is_sure_or_changes_little_is_not_looked_at_again():
    assert search(shown=20, other_way=-1.0)[1] == [], "sure by the held-out windows alone"
    (gain, _), asked = search(shown=0, other_way=-1.0)
    assert asked == [] and gain == 0
