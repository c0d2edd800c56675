"""What did as well as an effect when it was accepted is judged again beside all others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.answer.advice import predictions_apart
from idapt_pl.diagnosis.answer.equivalents import with_equivalents_of_now
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

N = 40
DAMPING, LATER = (Candidate(JointDamping, joint, ("damping",), (0.0,), (0.1,)) for joint in ("a", "b"))
ARMATURE = Candidate(JointArmature, "a", ("armature",), (0.0,), (0.1,))
FRICTION = Candidate(JointFrictionloss, "a", ("frictionloss",), (0.0,), (0.1,))


@pytest.fixture
def state():
    """Damping was found first and could have been armature or friction; then another damping was found."""
    windows = WhitenedWindows(Windows(np.repeat(np.arange(8), 5), np.arange(N), np.array([1])), np.zeros((N, 1, 1)))
    equal, friction = (Trial(c, 0, 10.0, (np.array([0.2]),), losses=np.ones(N)) for c in (ARMATURE, FRICTION))
    first = AcceptedEffect(0, DAMPING, np.array([0.5]), equivalent=(equal,), rivals=(equal, friction))
    splits = SimpleNamespace(held_out=windows, screen=windows, fit=windows)
    return SearchState((), (first, AcceptedEffect(1, LATER, np.array([0.6]))), splits)


def context(with_armature):
    """A search in which armature beside the later effect leaves so much; fits move the latter to 0.9."""
    noise = 0.001 * np.random.default_rng(0).normal(size=N)
    left = lambda effects: with_armature if any(e.name == "joint_armature" for e in effects) else 1.0  # noqa: E731
    moved = lambda c, x: np.array([0.9]) if c is LATER else x  # noqa: E731
    return SimpleNamespace(
        loss=lambda split, effects: left(effects) + noise,
        fit=lambda split, fixed, candidates, x, iterations: SimpleNamespace(
            x=tuple(moved(c, v) for c, v in zip(candidates, x, strict=True))
        ),
        whitened=lambda split, effects: np.array([[getattr(e, "damping", 0.0) for e in effects]]),
    )


def test_what_is_clearly_worse_beside_a_later_effect_is_a_mere_rival(state):
    first, second = with_equivalents_of_now(context(2.0), state).accepted
    assert first.equivalent == () and [t.candidate for t in first.rivals] == [ARMATURE, FRICTION]
    assert second is not None and first.x == 0.5, "what was found stays as it is"


@pytest.mark.parametrize("left", [1.0, 0.8])
def test_what_does_as_well_still_could_be_it_with_the_values_of_now(state, left):
    first, _ = with_equivalents_of_now(context(left), state).accepted
    (equal,) = first.equivalent
    assert equal.candidate is ARMATURE and np.concatenate(equal.x).tolist() == [0.9, 0.2]
    assert equal.held_out == pytest.approx(left, abs=0.01) and [t.candidate for t in first.rivals] == [FRICTION]


def in_fitted_windows_alone(state, left):
    """The state with other windows to fit to, and a search in which armature leaves so much there, else as much."""
    fit = WhitenedWindows(state.windows.held_out.windows, np.zeros((N, 1, 1)))
    apart = replace(state, windows=SimpleNamespace(held_out=state.windows.held_out, screen=fit, fit=fit))
    same, fitted = context(1.0), context(left)
    return apart, SimpleNamespace(
        loss=lambda split, effects: (fitted if split is fit else same).loss(split, effects), fit=same.fit
    )


def test_what_is_clearly_worse_in_the_windows_it_is_fitted_to_is_a_mere_rival(state):
    apart, search = in_fitted_windows_alone(state, 1.5)
    first, _ = with_equivalents_of_now(search, apart).accepted
    assert first.equivalent == () and [t.candidate for t in first.rivals] == [ARMATURE, FRICTION]
    apart, search = in_fitted_windows_alone(state, 1.0)
    assert with_equivalents_of_now(search, apart).accepted[0].equivalent


def test_another_number_of_parameters_is_judged_by_what_it_was_not_fitted_to_alone(state):
    two = Candidate(JointArmature, "a", ("armature", "armature"), (0.0, 0.0), (0.1, 0.1))
    trial = Trial(two, 0, 10.0, (np.array([0.2, 0.2]),), losses=np.ones(N))
    apart, search = in_fitted_windows_alone(state, 1.5)
    apart = replace(apart, accepted=(replace(apart.accepted[0], equivalent=(trial,)), apart.accepted[1]))
    assert [t.candidate for t in with_equivalents_of_now(search, apart).accepted[0].equivalent] == [two]


def test_what_was_accepted_meanwhile_is_no_equivalent(state):
    both = replace(state, accepted=(state.accepted[0], replace(state.accepted[1], candidate=ARMATURE)))
    assert with_equivalents_of_now(context(1.0), both).accepted[0].equivalent == ()


def test_predictions_are_compared_with_the_others_as_fitted_beside_each(state):
    search = context(1.0)
    now = with_equivalents_of_now(search, state)
    first, second = predictions_apart(search, now, now.accepted[0])
    assert first.tolist() == [[0.5, 0.6]] and second.tolist() == [[0.0, 0.9]]


@pytest.mark.parametrize(("gain", "left", "could_be"), [(9.5, 1.0, True), (9.5, 2.0, False), (5.0, 1.0, False)])
def test_a_rival_that_was_nearly_as_good_may_be_as_good_beside_what_was_found_since(state, gain, left, could_be):
    first, second = state.accepted
    (equal,) = first.equivalent
    near = replace(first, equivalent=(), rivals=(replace(equal, gain=gain),), gain=10.0)
    now, _ = with_equivalents_of_now(context(left), replace(state, accepted=(near, second))).accepted
    assert [t.candidate for t in now.equivalent] == [ARMATURE] * could_be
    alone = replace(state, accepted=(near,))
    assert with_equivalents_of_now(context(left), alone) is alone, "it was judged with nothing else missing"
