"""A search that ends with most of the error left begins again with rivals of its first effect."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds import other_beginnings
from idapt_pl.diagnosis.rounds.other_beginnings import begin_otherwise
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

NOTHING = 15.0
"""Loss without any effect."""


def candidate(joint):
    return Candidate(JointDamping, joint, ("damping",), (0.0,), (0.1,))


def trial(joint):
    return Trial(candidate(joint), 1, 1.0, (np.array([0.3]),), 1.0, np.ones(4))


@pytest.fixture
def search(monkeypatch):
    """``search(losses, leads)``: how it ends, and the beginnings that were tried.

    ``losses``: by the joints of a model's dampings. ``leads``: what a beginning leads to.
    """
    monkeypatch.setattr(other_beginnings, "refit_accepted", lambda context, state: state)
    monkeypatch.setattr(other_beginnings, "renew", lambda context, state: state)
    held_out = WhitenedWindows(Windows(np.zeros(4, int), np.arange(4), np.array([1])), np.zeros((4, 1, 1)))

    def run(losses, leads, ended=("a",), rivals="bc", alike=()):
        def left(windows, effects):
            return np.full(4, losses.get("".join(e.target for e in effects), NOTHING))

        def go_on(progress):
            began.append("".join(c.target for c in progress[0].candidates))
            return found(leads[began[-1]]), (*progress[1], "tried")

        def found(joints):
            tries = {"rivals": tuple(map(trial, rivals)), "equivalent": tuple(map(trial, alike))}
            effects = [AcceptedEffect(k, candidate(j), np.array([0.3])) for k, j in enumerate(joints)]
            return SearchState((), tuple(replace(e, **tries) for e in effects), SimpleNamespace(held_out=held_out))

        began = []
        state, trials = begin_otherwise(SimpleNamespace(loss=left), (found(ended), ("first",)), go_on)
        assert trials == ("first", *["tried"] * len(began)), "all that was tried is told"
        return "".join(c.target for c in state.candidates), began

    return run


def test_a_rival_that_leads_further_takes_the_place_of_the_first_effect(search):
    assert search({"a": 8.0, "b": 7.5, "cd": 1.05}, {"b": "b", "c": "cd"}) == ("cd", ["b", "c"])


def test_what_explains_all_ends_it(search):
    assert search({"a": 8.0, "bd": 1.05}, {"b": "bd"}) == ("bd", ["b"])


def test_a_little_better_is_not_enough(search):
    assert search({"a": 8.0, "b": 7.0, "c": 6.5}, {"b": "b", "c": "c"}) == ("a", ["b", "c"])


def test_where_most_is_explained_nothing_is_begun_again(search):
    assert search({"a": 2.5}, {}) == ("a", []), "less than 0.2 of what there was"
    assert search({"abc": 8.0}, {}, ended="abc") == ("abc", []), "a search that went on"
    assert search({"": 1.9, "a": 1.5}, {}) == ("a", []), "nearly at the noise"


def test_a_rival_that_does_the_same_is_no_other_beginning(search):
    assert search({"a": 8.0, "c": 8.0}, {"c": "c"}, alike="b") == ("a", ["c"])
