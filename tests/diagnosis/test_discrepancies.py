"""A search that ends close to the noise, yet not at it, makes its closest choices otherwise, one at a time."""

from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.rounds import discrepancies
from idapt_pl.diagnosis.rounds.discrepancies import choose_otherwise, close_choices
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows


def trial(joint, round, rough_loss, chosen=False):
    t = Trial(Candidate(JointDamping, joint, ("damping",), (0.0,), (0.1,)), round, 1.0, (np.array([0.3]),), rough_loss)
    return t if chosen else t.rejected(RejectionReason.WORSE, "another one leaves less")


TRIED = (
    *(trial("a", 0, 10.0, chosen=True), trial("p", 0, 14.0), trial("q", 0, 16.0)),
    *(trial("b", 1, 4.0, chosen=True), trial("r", 1, 3.6), trial("a2", 1, float("nan"))),
    *(trial("c", 2, 2.0, chosen=True), trial("s", 2, 2.4), trial("b", 2, 2.1)),
)
"""Three rounds: what was chosen, and rivals with what they left after rough fits."""


@pytest.fixture
def search(monkeypatch):
    """``search(losses, leads)``: how it ends, and the states from which it was made again."""
    monkeypatch.setattr(discrepancies, "refit_accepted", lambda context, state: state)
    monkeypatch.setattr(discrepancies, "renew", lambda context, state: state)
    held_out = WhitenedWindows(Windows(np.arange(4), np.zeros(4, int), np.array([1])), np.zeros((4, 1, 1)))

    def found(joints):
        effects = [AcceptedEffect(k, trial(j, k, 1.0).candidate, np.array([0.3])) for k, j in enumerate(joints)]
        return SearchState((), tuple(effects), SimpleNamespace(held_out=held_out))

    def run(losses, leads, ended="abc"):
        def left(windows, effects):
            return losses["".join(e.target for e in effects)] + np.array([-0.01, 0.01, -0.02, 0.02])

        def go_on(progress):
            began.append("".join(c.target for c in progress[0].candidates))
            return found(leads[began[-1]]), progress[1]

        began = []
        state, trials = choose_otherwise(SimpleNamespace(loss=left), (found(ended), TRIED), go_on)
        assert trials == TRIED
        return "".join(c.target for c in state.candidates), began

    return run


def test_the_closest_rivals_come_first():
    state = SearchState(
        (), tuple(AcceptedEffect(t.round, t.candidate, t.x[-1]) for t in TRIED if not t.rejection), None
    )
    assert [t.candidate.target for t in close_choices(state, TRIED)] == ["r", "s", "p"], "q is far, b was chosen later"


def test_what_comes_before_a_choice_stays(search):
    assert search({"abc": 3.0, "ard": 1.0}, {"ar": "ard"}) == ("ard", ["ar"]), "what explains all ends it"
    assert search({"abc": 3.0, "ar": 2.9, "abs": 1.4}, {"ar": "ar", "abs": "abs"}) == ("abs", ["ar", "abs"])


def test_a_little_better_is_no_other_choice(search):
    assert search({"abc": 3.0, "ar": 2.6, "abs": 2.6}, {"ar": "ar", "abs": "abs"}) == ("abc", ["ar", "abs"])


@pytest.mark.parametrize(("loss", "ended"), [(1.1, "abc"), (20.0, "abc"), (3.0, "a")])
def test_at_the_noise_far_from_it_or_with_one_effect_nothing_is_chosen_again(search, loss, ended):
    assert search({ended: loss}, {}, ended=ended) == (ended, [])
