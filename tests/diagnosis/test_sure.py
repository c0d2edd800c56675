"""What may as well be as the model has it, and what makes longer replays worse, is no finding."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.fit import CandidateFit
from idapt_pl.diagnosis.last_resort import is_narrower
from idapt_pl.diagnosis.rounds import replay
from idapt_pl.diagnosis.rounds.measurement import measure_intervals, windows_in_line
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping, JointStribeck
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.effects.world import GravityDirection
from idapt_pl.estimation.least_squares import LeastSquaresFit
from idapt_pl.prediction.data import Recording, Windows, choose_rows, over_impacts, with_impacts
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.prediction.whitening import WhitenedWindows

DELAY = Candidate(ActuatorDelay, "*", ("delay",), (0.0,), (0.02,))
FALLING = Candidate(JointStribeck, "a", ("coulomb", "static", "speed"), (0.0, 0.0, 1.0), (0.1, 0.1, 1.0), strength=2)

NO_ERRORS = SimpleNamespace(systematic=())


@pytest.mark.parametrize(
    ("candidate", "interval", "unsure"),
    [
        (DELAY, [(0.0, 0.0052)], True),
        (DELAY, [(0.001, 0.0052)], False),
        (FALLING, [(0.0, 0.3), (0.1, 0.4), (0.5, 2.0)], False),
        (FALLING, [(0.0, 0.3), (0.0, 0.4), (2.0, 3.0)], True),
    ],
    ids=["delay that may be none", "delay", "one level is sure", "where it falls is no strength"],
)
def test_an_effect_is_unsure_if_all_that_says_how_strong_it_is_may_be_nominal(candidate, interval, unsure):
    x = np.mean(interval, 1)
    assert AcceptedEffect(0, candidate, x, interval=np.array(interval)).unsure is unsure
    assert not AcceptedEffect(0, candidate, x).unsure, "nothing is known before it is measured"


class Replays:
    """A simulator whose residual is what an effect says, of one channel that moves by 1."""

    compared = np.array([True])

    def __init__(self):
        self.data = [np.zeros(100)] * 2

    def residual(self, effects, windows):
        return np.full((len(windows), 2, 1), effects) + 0.01 * np.arange(len(windows))[:, None, None]

    def measured(self, windows, offsets):
        return np.ones((len(windows), len(offsets), 1)), np.zeros((len(windows), len(offsets), 1))

    def difference(self, one, other):
        return np.ones((len(one[0]), one[0].shape[1], 1))


def test_what_makes_longer_replays_worse_is_seen(monkeypatch):
    windows = Windows(np.zeros(20, int), np.arange(20), np.array([1, 2]))
    monkeypatch.setattr(replay, "long_windows", lambda context: windows)
    context = SimpleNamespace(sim=Replays(), settings=SimpleNamespace(sureness=1.2))
    small, large = SimpleNamespace(effects=0.1), SimpleNamespace(effects=0.5)
    assert replay.worse_replays(context, with_it=large, without=small)
    assert not replay.worse_replays(context, with_it=small, without=large)
    assert not replay.worse_replays(context, with_it=small, without=small)


def test_a_replay_is_never_worse_than_standing_still():
    windows = Windows(np.zeros(3, int), np.arange(3), np.array([1, 2]))
    losses = replay.replay_losses(SimpleNamespace(sim=Replays()), SimpleNamespace(effects=50.0), windows)
    np.testing.assert_array_equal(losses, 1.0)


def test_windows_over_impacts_are_a_third_where_impacts_are_rare():
    hit = np.zeros(300, bool)
    hit[::15] = True  # 20 of 300
    rows = choose_rows(hit, 250, np.random.default_rng(0))
    assert hit[rows].sum() == 20 and len(rows) == 60 and (np.diff(rows) > 0).all()
    often = np.arange(300) % 2 == 0
    assert len(choose_rows(often, 250, np.random.default_rng(0))) == 250, "nothing to do"
    assert len(choose_rows(np.zeros(30, bool), 250, np.random.default_rng(0))) == 30


def test_an_impact_is_a_jump_of_a_velocity():
    ball = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 1"><freejoint/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    rng, time = np.random.default_rng(0), 0.01 * np.arange(81)
    qvel = 0.01 * rng.normal(size=(81, 6))
    qvel[:, 2] -= 9.81 * time
    qvel[40:, 2] += 5.0
    flight = Recording("toss", time, np.zeros((81, 7)), qvel, np.zeros((80, 0)))
    (seen,) = with_impacts(ball, [flight])
    assert set(np.flatnonzero(seen.impacts)) <= {39, 40, 41} and seen.impacts.any()
    windows = Windows(np.zeros(3, int), np.array([20, 36, 60]), np.array([1, 5]))
    assert over_impacts([seen], windows).tolist() == [False, True, False]


def test_only_what_is_narrower_than_possible_is_looked_at_again():
    tilt = Candidate(GravityDirection, "world", ("tilt_x",), (0.0,), (0.1,), plausible=((-0.26, 0.26),))
    anything = Candidate(JointDamping, "a", ("damping",), (0.0,), (0.1,))
    assert is_narrower(tilt) and not is_narrower(anything)


def test_what_no_recording_shows_may_be_anything_in_its_range():
    rng = np.random.default_rng(0)
    z, J = rng.normal(size=(40, 5)), np.stack([rng.normal(size=200), np.zeros(200)], 1)
    span, names = ((0.0, 1.0), (-0.5, 2.0)), ("time_constant", "dead_time")
    two = Candidate(ActuatorLag, "*", names, (0.0, 0.0), (0.02, 0.02), span=span)
    episode = np.repeat(np.arange(8), 5)
    windows = WhitenedWindows(Windows(episode, np.arange(40), np.array([1])), np.ones((40, 5, 1)))
    state = SearchState((), (AcceptedEffect(0, two, np.zeros(2)),), SimpleNamespace(fit=windows, noise=NO_ERRORS))
    solution = LeastSquaresFit(np.array([0.3, 0.1]), 1.0, J, z)
    context = SimpleNamespace(
        fit=lambda *args, **options: CandidateFit((solution.x,), solution),
        whitened=lambda split, effects: z,
        loss=lambda split, effects: np.ones(len(split.windows)),
        sim=SimpleNamespace(
            compile=lambda fixed: SimpleNamespace(opt=SimpleNamespace(timestep=0.0)), side_by_side=SideBySide(1)
        ),
    )
    measured = measure_intervals(context, state).accepted[0]
    seen, unseen = measured.interval
    assert 0.001 < np.ptp(seen) < 0.05 and seen.mean() == pytest.approx(0.3)
    assert unseen.tolist() == [-0.5, 2.0]
    assert measured.x == pytest.approx([0.3, 0.0]), "the fit's 0.1 is of no recording"
    where = replace(two, strength=1)
    state = replace(state, accepted=(AcceptedEffect(0, where, np.zeros(2)),))
    assert measure_intervals(context, state).accepted[0].x == pytest.approx([0.3, 0.1]), "no strength, but where or how"


@pytest.mark.parametrize(("out", "kept"), [([7], 39), ([7, 20], 38), (range(5), 40)], ids=["one", "two", "too many"])
def test_estimates_are_not_of_windows_out_of_line(out, kept):
    windows = WhitenedWindows(Windows(np.repeat(np.arange(8), 5), np.arange(40), np.array([1])), np.ones((40, 5, 1)))
    losses = np.where(np.isin(np.arange(40), out), 60.0, 1.0)
    context = SimpleNamespace(loss=lambda split, effects: losses)
    told = windows_in_line(context, SearchState((), (), SimpleNamespace(fit=windows)))
    assert len(told.windows) == kept and (kept == 40 or not set(out) & set(told.windows.start))
