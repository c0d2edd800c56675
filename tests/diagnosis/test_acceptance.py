"""Which of the refitted candidates is accepted, and what is said of the others."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds import acceptance
from idapt_pl.diagnosis.rounds.acceptance import accept, rough_fits
from idapt_pl.diagnosis.rounds.gates import (
    GATES,
    Judged,
    earns_its_place,
    objection,
    objections,
    why_implausible,
)
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.bodies import BodyCom
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import SensorGain
from idapt_pl.effects.world import GravityDirection
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

N = 40
DAMPING = Candidate(JointDamping, "elbow", ("damping",), (0.0,), (0.1,))
OTHER = Candidate(JointDamping, "shoulder", ("damping",), (0.0,), (0.1,))
CENTRE = Candidate(BodyCom, "upper", ("x", "y", "z"), (0.0,) * 3, (0.1,) * 3)
GAIN = Candidate(SensorGain, "elbow", ("gain",), (1.0,), (0.2,), span=((0.8, 1.25),))


@pytest.fixture
def state():
    """A model with one effect, judged on 40 windows of eight episodes."""
    windows = Windows(np.repeat(np.arange(8), 5), np.arange(N), np.array([1]))
    before = AcceptedEffect(0, OTHER, np.array([0.2]))
    return SearchState((), (before,), SimpleNamespace(held_out=WhitenedWindows(windows, np.zeros((N, 1, 1)))))


def trial(candidate, loss, seed=0, round=1, gain=3.0):
    """A refined trial with a mean held-out loss."""
    losses = loss + 0.001 * np.random.default_rng(seed).normal(size=N)
    x = (np.array([0.3]), np.full(candidate.size, 0.05))
    return Trial(candidate, round, 100.0, x, 1.0, losses, gain, 0.1)


def judged(t, level, further):
    """A trial with what it is judged by: a model that leaves ``level`` without it."""
    return Judged(t.candidate, t.x[-1], t.gain, t.gain_error, level, further, SearchSettings())


def test_the_one_that_leaves_least_is_accepted_and_the_others_are_worse(state):
    best, worse = trial(DAMPING, 1.0), trial(CENTRE, 2.0)
    found, (first, second) = accept(state, [best, worse])
    assert [a.candidate for a in found.accepted] == [OTHER, DAMPING]
    assert found.accepted[0].x == 0.3 and found.accepted[1].x == 0.05, "earlier estimates move along"
    assert found.accepted[1].rivals == (worse,) and found.accepted[1].round == 1
    assert first.rejection is None and second.rejection.reason is RejectionReason.WORSE
    assert "joint_damping(elbow) leaves less (1 against 2)" in second.rejection.text


def test_the_state_before_stays_as_it_was(state):
    accept(state, [trial(DAMPING, 1.0)])
    assert [a.candidate for a in state.accepted] == [OTHER] and state.accepted[0].x == 0.2


def test_of_those_as_good_the_one_with_fewest_parameters_is_accepted(state):
    many, few = trial(CENTRE, 1.0), trial(DAMPING, 1.0005, seed=1)
    found, (first, _) = accept(state, [many, few])
    assert found.accepted[-1].candidate is DAMPING
    assert found.accepted[-1].equivalent == (many,)
    assert first.rejection.reason is RejectionReason.EQUIVALENT


def test_a_sensor_is_blamed_only_if_it_is_clearly_better(state):
    found, _ = accept(state, [trial(GAIN, 1.0), trial(DAMPING, 1.05, seed=1)])
    assert found.accepted[-1].candidate is DAMPING


def test_nothing_is_accepted_where_nothing_passed(state):
    refused = trial(DAMPING, 1.0).rejected(RejectionReason.UNSURE_GAIN, "perhaps chance")
    assert accept(state, [refused]) == (None, [refused])


@pytest.mark.parametrize(
    ("change", "level", "reason"),
    [
        ({}, 4.0, None),
        ({"gain_error": 3.0}, 4.0, RejectionReason.UNSURE_GAIN),
        ({"gain": 0.05, "gain_error": 0.001}, 4.0, RejectionReason.SMALL_GAIN),
        ({"gain": 0.09, "gain_error": 0.001}, 4.0, None),
        ({"x": (np.array([0.001]),), "gain": 0.4}, 4.0, RejectionReason.SMALL_CHANGE),
        ({"x": (np.array([0.001]),)}, 4.0, None),
    ],
    ids=["clear", "unsure", "too little", "enough", "tiny", "tiny, and yet much of what is left"],
)
def test_each_objection_has_its_reason(change, level, reason):
    t = Trial(**{**vars(trial(DAMPING, 1.0)), **change})
    rejection = objection(judged(t, level, further=t.round > 0))
    assert (rejection and rejection.reason) == reason
    assert rejection is None or rejection.text


def test_a_first_effect_is_not_asked_what_further_ones_are_however_late_it_comes():
    """After all that was found before was left out again, the next one is a first effect."""
    late = Trial(**{**vars(trial(DAMPING, 1.0, round=5)), "x": (np.array([0.001]),), "gain": 0.4})
    assert objection(judged(late, 4.0, further=False)) is None
    assert objection(judged(late, 4.0, further=True)).reason is RejectionReason.SMALL_CHANGE


@pytest.mark.parametrize(("gain", "error", "earned"), [(0.5, 0.1, True), (0.05, 0.001, False), (0.5, 0.6, False)])
def test_what_is_asked_when_an_effect_is_added_is_asked_again_later(gain, error, earned):
    t = Trial(**{**vars(trial(DAMPING, 1.0)), "gain": gain, "gain_error": error})
    assert earns_its_place(judged(t, 4.0, further=True)) is earned
    assert (objection(judged(t, 4.0, further=True)) is None) is earned


@pytest.mark.parametrize(("level", "further", "earned"), [(1.0, True, False), (2.0, True, True), (1.0, False, True)])
def test_where_nothing_is_left_a_further_effect_must_surely_help(level, further, earned):
    """1.4 standard errors: of many candidates one may have that by chance."""
    t = Trial(**{**vars(trial(DAMPING, 1.0)), "gain": 0.07, "gain_error": 0.05})
    refused = objection(judged(t, level, further))
    assert (refused is None) is earned
    assert earned or refused.reason is RejectionReason.UNSURE_GAIN


def test_a_sensor_at_the_end_of_what_sensors_are_off_by_stands_in_for_something_else():
    at_end = Trial(GAIN, 0, 100.0, (np.array([1.25]),), 1.0, np.ones(N), 3.0, 0.1)
    assert objection(judged(at_end, 4.0, further=at_end.round > 0)).reason is RejectionReason.BEYOND_SENSORS


def test_what_machines_do_not_have_is_refused_with_the_reason():
    tilt = Candidate(GravityDirection, "world", ("tilt_x",), (0.0,), (0.1,), plausible=((-0.26, 0.26),))
    at_end = Trial(tilt, 0, 100.0, (np.array([0.26]),), 1.0, np.ones(N), 3.0, 0.1)
    rejection = objection(judged(at_end, 4.0, further=at_end.round > 0))
    assert rejection.reason is RejectionReason.IMPLAUSIBLE
    assert "tilt_x above 0.26 rad is not plausible: machines are set up by eye" in rejection.text
    inside = Trial(tilt, 0, 100.0, (np.array([0.1]),), 1.0, np.ones(N), 3.0, 0.1)
    assert objection(judged(inside, 4.0, further=inside.round > 0)) is None


def test_an_end_that_no_simulation_goes_beyond_is_no_objection():
    """No friction at all is the end of what is possible, and a fit that stays there wants no more."""
    friction = Candidate(JointDamping, "elbow", ("damping",), (0.3,), (0.1,), plausible=((0.0, 5.0),))
    assert why_implausible(friction, np.array([0.0])) == ""
    assert "damping above 5" in why_implausible(friction, np.array([5.0]))


def test_all_gates_that_a_candidate_does_not_pass_are_told_the_first_one_first():
    t = Trial(**{**vars(trial(DAMPING, 1.0)), "gain": 0.05, "gain_error": 0.06, "x": (np.array([0.001]),)})
    told = list(objections(judged(t, 4.0, further=True)))
    assert [gate.__name__ for gate, _ in told] == ["sure_gain", "share_of_error", "noticeable"]
    assert objection(judged(t, 4.0, further=True)) == told[0][1]
    assert all(gate(judged(trial(DAMPING, 1.0), 4.0, further=True)) is None for gate in GATES)


def test_all_gates_can_be_asked_where_nothing_is_above_the_floor():
    t = Trial(**{**vars(trial(DAMPING, 1.2)), "gain": -0.2})
    assert next(objections(judged(t, 0.99, further=False)))[0].__name__ == "sure_gain"


def test_fits_that_would_not_come_to_what_is_asked_for_are_left_and_the_others_are_the_same():
    damped = ARM.replace('damping="0.05"', 'damping="0.6"')
    context, _ = begin_search(mujoco.MjSpec.from_string(ARM), record(damped, episodes=4), threads=1)
    right, wrong = (
        Trial(c, 0, 100.0, (np.array(c.nominal),))
        for c in context.candidates
        if c.label in ("joint_damping(shoulder)", "joint_stiffness(elbow)")
    )

    def fitted(**asked):
        """Both by candidate, and how many simulations that took."""
        context, state = begin_search(mujoco.MjSpec.from_string(ARM), record(damped, episodes=4), threads=1)
        before = context.sim.calls
        found = {t.candidate: t for t in rough_fits(context, state, [right, wrong], **asked)}
        return found[right.candidate], found[wrong.candidate], context.sim.calls - before

    whole, poor, simulations = fitted()
    same, left, fewer = fitted(good_enough=1.2)
    assert whole.rough_loss < 1.2 < poor.rough_loss
    assert np.array_equal(same.x[0], whole.x[0]) and same.rough_loss == whole.rough_loss
    assert np.array_equal(left.x[0], wrong.x[0]) and left.rough_loss > 1.2, "not a step was taken"
    assert fewer < simulations


@pytest.mark.parametrize(("wide", "simplest_first"), [(0.99999, True), (0.9, False)])
def test_of_rough_fits_that_do_the_same_the_simplest_comes_first(wide, simplest_first, monkeypatch):
    """Ten parameters leave a little less than one by chance."""
    context, state = begin_search(mujoco.MjSpec.from_string(ARM), record(episodes=4), threads=1)
    leaves = {"body_mass(lower)": 1.0, "body_inertia(lower)": wide}

    def fitted(residual, state, t, steps, slopes, good_enough):
        return replace(t, rough_loss=leaves[t.candidate.label]), slopes

    monkeypatch.setattr(acceptance, "rough_fit", fitted)
    tried = [Trial(c, 0, 100.0, (np.array(c.nominal),)) for c in context.candidates if c.label in leaves]
    for order in (tried, tried[::-1]):
        first = rough_fits(context, state, order)[0].candidate.label
        assert first == ("body_mass(lower)" if simplest_first else "body_inertia(lower)")
