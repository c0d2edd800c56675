"""An effect that few held-out windows show is judged on the others as well, by a fit that has not seen them."""

from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.rounds.both_ways import MOST_COUNTED, gain_counted, gain_on_all
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

END = Candidate(JointRange, "hip", ("lower",), (-9.0,), (0.1,))
HELD_OUT, FITTED = 30, 90


def split(n, first):
    windows = Windows(first + np.repeat(np.arange(n // 10), 10), np.arange(n), np.array([1]))
    return WhitenedWindows(windows, np.zeros((n, 1, 1)))


def search(shown, other_way, fitted_shown=FITTED):
    """Windows that lose 50 where the stop shows and a model has it not at -1; ``other_way``: what a fit finds there.

    It shows in the first ``shown`` held-out windows, and in every ninth of the first ``fitted_shown`` others.
    """
    held_out, fit = split(HELD_OUT, 0), split(FITTED, 3)
    asked = []

    def loss(windows, effects):
        row, of_held_out = windows.windows.start, windows.windows.episode < 3
        shows = np.where(of_held_out, row < shown, (row % 9 == 0) & (row < fitted_shown))
        return 1.0 + 50.0 * (shows & (not any(e.lower == -1.0 for e in effects)))

    def fitted(windows, fixed, candidates, x, steps):
        asked.append(np.unique(windows.windows.episode).tolist())
        return SimpleNamespace(x=[np.array([other_way])])

    state = SimpleNamespace(fixed=(), windows=SimpleNamespace(held_out=held_out, fit=fit))
    context = SimpleNamespace(loss=loss, fit=fitted)
    losses = loss(held_out, ()), loss(held_out, effects_of([END], [np.array([-1.0])]))
    return gain_on_all(context, state, [END], [np.array([-1.0])], (), losses, sure=2.0), asked


def test_what_one_window_shows_is_looked_for_in_the_windows_of_the_fit():
    (gain, error), asked = search(shown=1, other_way=-1.0)
    assert asked == [[0, 1, 2]], "fitted to the held-out windows"
    assert gain == pytest.approx(50 * 11 / 120) and gain > 2 * error


def test_what_a_fit_to_the_held_out_windows_does_not_find_stays_unsure():
    (gain, error), asked = search(shown=1, other_way=-0.5)
    assert asked == [[0, 1, 2]] and 0 < gain < 2 * error


def test_what_is_sure_is_not_looked_at_again():
    assert search(shown=20, other_way=-1.0)[1] == [], "sure by the held-out windows alone"


def test_what_no_held_out_window_shows_is_judged_by_halves_of_the_others():
    (gain, error), asked = search(shown=0, other_way=-1.0)
    one, other = asked
    assert sorted([*one, *other]) == list(range(3, 12)), "each episode is left out of one fit"
    assert gain == pytest.approx(50 * 10 / 120) and gain > 2 * error


def test_what_the_other_half_does_not_find_is_no_gain():
    (gain, _), asked = search(shown=0, other_way=-0.5)
    assert len(asked) == 2 and gain == 0


def test_what_one_episode_shows_is_not_judged_by_halves():
    (gain, _), asked = search(shown=0, other_way=-1.0, fitted_shown=9)
    assert asked == [] and gain == 0


def test_what_changes_nothing_anywhere_is_no_gain():
    (gain, _), asked = search(shown=0, other_way=-1.0, fitted_shown=0)
    assert asked == [] and gain == 0


def counted(gains, windows=180):
    """The gain of an effect that these windows show, each in an episode of its own, in standard errors."""
    after = np.ones(windows)
    before = after + np.concatenate([gains, np.zeros(windows - len(gains))])
    gain, error = gain_counted(before, after, np.arange(windows) % 18)
    assert gain == pytest.approx(np.sum(gains) / windows)
    return gain / error


def test_a_large_gain_is_no_reason_to_doubt_the_others():
    most = counted([MOST_COUNTED] * 3)
    assert counted([258.0, 95.0, 65.0]) == pytest.approx(most) and most > 1.7
    assert counted([258.0]) < 1.01, "one window may be anything"
    assert counted([5.0] * 3) == pytest.approx(np.sqrt(3), rel=0.02), "as before"
    assert counted([258.0] + [-5.0] * 3) == 0, "many small losses are not made up for by one window"
