"""Early choices are reopened: a rival takes a place, and what is needless goes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds import revision
from idapt_pl.diagnosis.rounds.revision import eliminate_needless, keep_sure, swap_one, with_its_doubts, with_rival
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.prediction.whitening import WhitenedWindows

N = 40


@pytest.fixture(autouse=True)
def no_longer_replays(monkeypatch):
    """What longer replays say is tested in test_sure.py; here there is no simulator."""
    monkeypatch.setattr(revision, "worse_replays", lambda context, with_it, without: False)


def on(joint, kind=JointDamping, name="damping"):
    return Candidate(kind, joint, (name,), (0.0,), (0.1,))


A, B, C = on("a"), on("b"), on("c")
RIVAL = on("a", JointArmature, "armature")


def accepted(*candidates):
    windows = Windows(np.repeat(np.arange(8), 5), np.arange(N), np.array([1]))
    held_out = WhitenedWindows(windows, np.zeros((N, 1, 1)))
    found = tuple(AcceptedEffect(k, c, np.array([0.5])) for k, c in enumerate(candidates))
    return SearchState((), found, SimpleNamespace(held_out=held_out, fit=held_out))


def context(loss):
    """A search in which ``loss(names)`` is what effects on these (kind, target) leave; fits keep where they start."""
    rng = np.random.default_rng(0)
    noise = 0.001 * rng.normal(size=N)

    def fit(split, fixed, candidates, x, iterations, slopes=None, good_enough=np.inf):
        left = loss({(c.kind.name, c.target) for c in candidates}) > good_enough
        return SimpleNamespace(x=tuple(x), solution=SimpleNamespace(given_up=left))

    return SimpleNamespace(
        settings=SearchSettings(numerics=False), numerics_declared=False, progress=lambda what, done: None,
        loss=lambda split, effects: loss({(e.name, e.target) for e in effects}) + noise,
        fit=fit, sim=SimpleNamespace(side_by_side=SideBySide(1)),
        whitened=lambda split, effects: np.zeros((N, 1)), with_coarse_numerics=lambda effects, step: effects,
        coarse_step=lambda split, effects: 0.01,
    )  # fmt: skip


def names(state):
    return [c.label for c in state.candidates]


def test_what_the_others_can_do_without_is_left_out():
    needed = {("joint_damping", "b")}
    state = eliminate_needless(context(lambda found: 1.0 if needed <= found else 5.0), accepted(A, B, C))
    assert names(state) == ["joint_damping(b)"]


def test_what_helps_stays():
    state = accepted(A, B)
    kept = eliminate_needless(context(lambda found: 5.0 - 2 * len(found)), state)
    assert names(kept) == ["joint_damping(a)", "joint_damping(b)"]


def test_the_last_effect_stays_even_if_it_does_nothing():
    assert names(eliminate_needless(context(lambda found: 1.0), accepted(A, B))) == ["joint_damping(b)"]


def test_a_fit_that_was_left_too_early_is_finished_before_an_effect_goes(monkeypatch):
    """Left early it says that nothing is lost on held-out windows; fitted to the end it says the same."""
    finished = []
    monkeypatch.setattr(revision, "refit_accepted", lambda context, state: finished.append(names(state)) or state)
    search = context(lambda found: 1.0)
    search.fit = lambda *a, **k: SimpleNamespace(x=tuple(a[3]), solution=SimpleNamespace(given_up=True))
    assert names(eliminate_needless(search, accepted(A, B))) == ["joint_damping(b)"]
    assert finished == [["joint_damping(b)"]]


def test_a_rival_takes_the_place_and_the_others_keep_theirs():
    old = accepted(A, B, C)
    new = with_rival(old, old.accepted[1], RIVAL, [np.array([1.0]), np.array([3.0]), np.array([2.0])])
    assert names(new) == ["joint_damping(a)", "joint_armature(a)", "joint_damping(c)"]
    assert np.concatenate(new.estimates).tolist() == [1.0, 2.0, 3.0]
    assert [e.round for e in new.accepted] == [0, 1, 2] and new.accepted[1].equivalent == ()
    assert names(old) == ["joint_damping(a)", "joint_damping(b)", "joint_damping(c)"]


def test_a_rival_that_is_not_clearly_better_changes_nothing():
    state = accepted(A, B)
    trial = Trial(RIVAL, 0, 10.0, (np.array([0.2]),), gain=1.0)
    assert swap_one(context(lambda found: 2.0), state, 0, [trial]) is state


@pytest.mark.parametrize(("better", "swapped"), [(1.0, True), (1.98, False)])
def test_a_rival_has_to_remove_a_noticeable_part(better, swapped, monkeypatch):
    monkeypatch.setattr("idapt_pl.diagnosis.rounds.revision.renew", lambda context, state: state)
    state, trial = accepted(A, B), Trial(RIVAL, 0, 10.0, (np.array([0.2]),), gain=1.0)
    search = context(lambda found: better if ("joint_armature", "a") in found else 2.0)
    now = swap_one(search, state, 0, [trial])
    assert (names(now)[0] == "joint_armature(a)") is swapped


def test_what_is_accepted_in_another_place_is_no_rival():
    """Found in an earlier round as a rival, accepted in a later one: twice it would be another model, or none."""
    state, trial = accepted(A, B), Trial(B, 0, 10.0, (np.array([0.2]),), gain=1.0)
    assert (
        swap_one(context(lambda found: 1.0 if ("joint_damping", "a") not in found else 2.0), state, 0, [trial]) is state
    )


def test_more_parameters_have_to_be_worth_it(monkeypatch):
    monkeypatch.setattr("idapt_pl.diagnosis.rounds.revision.renew", lambda context, state: state)
    wide = Candidate(JointFrictionloss, "a", ("frictionloss",) * 8, (0.0,) * 8, (0.1,) * 8)
    state, trial = accepted(A, B), Trial(wide, 0, 10.0, (np.full(8, 0.2),), gain=1.0)
    search = context(lambda found: 1.5 if ("joint_frictionloss", "a") in found else 2.0)
    assert swap_one(search, state, 0, [trial]) is state


@pytest.mark.parametrize(("size", "error", "swapped"), [(1, 0.14, True), (2, 0.14, False), (2, 0.1, True)])
def test_a_rival_of_more_parameters_must_surely_be_better(size, error, swapped, monkeypatch):
    """A gain of 0.2 is 1.4 standard errors, or 2."""
    monkeypatch.setattr(revision, "renew", lambda context, state: state)
    monkeypatch.setattr(revision, "paired_gain", lambda now, after, episode: (float((now - after).mean()), error))
    rival = Candidate(JointArmature, "a", ("armature",) * size, (0.0,) * size, (0.1,) * size)
    state, trial = accepted(A, B), Trial(rival, 0, 10.0, (np.full(size, 0.2),), gain=1.0)
    search = context(lambda found: 1.8 if ("joint_armature", "a") in found else 2.0)
    assert (names(swap_one(search, state, 0, [trial]))[0] == "joint_armature(a)") is swapped


def test_what_makes_longer_replays_worse_is_left_out(monkeypatch):
    b_makes_worse = lambda context, with_it, without: "joint_damping(b)" not in names(without)  # noqa: E731
    monkeypatch.setattr(revision, "worse_replays", b_makes_worse)
    kept = eliminate_needless(context(lambda found: 5.0 - 0.5 * len(found)), accepted(A, B))
    assert names(kept) == ["joint_damping(a)"]
    kept = eliminate_needless(context(lambda found: 5.0 - 2 * len(found)), accepted(A, B))
    assert names(kept) == ["joint_damping(a)", "joint_damping(b)"], "what removes much of the error is no doubtful one"


GAIN = Candidate(ActuatorGain, "*", ("gain",), (1.0,), (0.1,))
SCALED = {("joint_damping", "a"), ("joint_damping", "b"), ("joint_damping", "c")}


@pytest.mark.parametrize(
    ("loss", "kept"),
    [
        (lambda found: 1.0 if ("actuator_gain", "*") in found or found >= SCALED else 9.0, ["actuator_gain(*)"]),
        (lambda found: 1.0 if found >= SCALED else 9.0, ["joint_damping(a)", "joint_damping(b)", "joint_damping(c)"]),
    ],
    ids=["a gain does it", "it does not"],
)
def test_a_gain_takes_the_place_of_all_that_it_scales(loss, kept, monkeypatch):
    monkeypatch.setattr(revision, "renew", lambda context, state: state)
    search = context(loss)
    search.candidates, search.sim.model = [A, B, C, GAIN], SimpleNamespace(nu=2)
    assert names(revision.one_gain_for_many(search, accepted(A, B, C))) == kept
    two = accepted(A, B)
    assert revision.one_gain_for_many(search, two) is two


def test_places_that_stood_beside_the_last_change_are_not_gone_through_again(monkeypatch):
    """Of four places the second gets another effect: the next pass ends there, as the others saw it already."""
    seen = []

    def swap(context, state, place, rivals):
        seen.append(place)
        return replace(state) if seen == [0, 1] else state

    monkeypatch.setattr(revision, "swap_one", swap)
    monkeypatch.setattr(revision, "rivals_for", lambda context, state, place: [])
    revision.swap_for_rivals(context(lambda found: 100.0), accepted(A, B, C, RIVAL))
    assert seen == [0, 1, 2, 3, 0, 1]


def test_what_may_be_as_the_model_has_it_is_left_out_and_the_rest_measured_again(monkeypatch):
    """One interval holds the nominal value; it goes, and the other estimate stays."""
    ends = {"joint_damping(a)": (0.4, 0.6), "joint_damping(b)": (-0.1, 1.1)}
    measure = lambda context, state: replace(  # noqa: E731
        state, accepted=tuple(replace(a, interval=np.array([ends[a.candidate.label]])) for a in state.accepted)
    )
    for name, keep in (("measure_intervals", measure), ("renew", lambda context, state: state)):
        monkeypatch.setattr(revision, name, keep)
    kept = keep_sure(context(lambda found: 1.0), accepted(A, B))
    assert names(kept) == ["joint_damping(a)"] and kept.accepted[0].interval.tolist() == [[0.4, 0.6]]
    nothing = keep_sure(context(lambda found: 1.0), accepted(B))
    assert nothing.accepted == ()


def test_what_the_last_fit_drove_to_the_end_of_its_range_says_so():
    inside = AcceptedEffect(0, replace(A, plausible=((0.0, 9.0),)), np.array([0.5]))
    at_end = AcceptedEffect(0, replace(A, plausible=((0.0, 0.5),)), np.array([0.5]))
    assert not with_its_doubts(inside).implausible
    assert "damping above 0.5" in with_its_doubts(at_end).implausible
