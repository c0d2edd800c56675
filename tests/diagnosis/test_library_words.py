"""A law that is made of effects of the library is said in their words, and a shared effect is taken apart for it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.laws.candidate import law_candidate
from idapt_pl.diagnosis.laws.library_words import SAME_IN_LIBRARY, explained_by_library, motors_of
from idapt_pl.diagnosis.laws.terms import OF_THE_LIBRARY, JointSizes, dictionary
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.taking_apart import single_for_shared, taken_apart
from idapt_pl.diagnosis.search import next_round
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, refit_accepted
from idapt_pl.effects.base import ACTUATED
from idapt_pl.effects.joints import JointDamping

SIZES = JointSizes("elbow", True, np.linspace(-1, 1, 7), 2.0, 1.0, 1.0, 0.02, "u")

NOMINAL = ARM.replace('damping="0.02"', 'damping="0.05"')


def law_of(*texts):
    terms = [next(t for t in dictionary(SIZES) if t.text == text) for text in texts]
    return law_candidate(SIZES, terms, np.ones(len(terms)), np.ones(len(terms)))[0]


@pytest.fixture(scope="module")
def search():
    """The shoulder has more damping and the elbow's motor is weak; a damping of both joints was found."""
    weak = NOMINAL.replace('joint="elbow"/>', 'joint="elbow" gear="0.7"/>')
    hidden = weak.replace('"shoulder" axis="0 1 0" damping="0.05"', '"shoulder" axis="0 1 0" damping="0.15"')
    context, state = begin_search(mujoco.MjSpec.from_string(NOMINAL), record(hidden), threads=1)
    shared = next(c for c in context.candidates if c.kind is JointDamping and c.target in ("*", ACTUATED))
    state = replace(state, accepted=(AcceptedEffect(0, shared, np.array(shared.nominal) + 0.1),))
    return context, refit_accepted(context, state)


def labels(state):
    return sorted(c.label for c in state.candidates)


def test_the_law_becomes_effects_and_the_shared_one_is_taken_apart(search):
    context, state = search
    other = explained_by_library(context, state, law_of("A*u", "A*v"))
    assert labels(other) == ["actuator_gain(e)", "joint_damping(shoulder)"]
    values = {c.label: float(x[0]) for c, x in zip(other.candidates, other.estimates, strict=True)}
    assert values["actuator_gain(e)"] == pytest.approx(0.7, abs=0.02)
    assert values["joint_damping(shoulder)"] == pytest.approx(0.15, abs=0.02)
    assert context.loss(other.windows.held_out, other.effects).mean() < 1.2


def test_a_law_whose_effects_explain_little_changes_nothing(search):
    context, state = search
    right = explained_by_library(context, state, law_of("A*u", "A*v"))
    assert explained_by_library(context, right, law_of("A*q")) is None


def test_no_more_effects_than_allowed(search):
    context, state = search
    narrow = replace(context, settings=replace(context.settings, max_effects=2))
    assert explained_by_library(narrow, state, law_of("A*u", "A*v")) is None


def test_every_term_of_the_library_has_an_effect_and_laws_of_others_have_not():
    assert set(SAME_IN_LIBRARY) == OF_THE_LIBRARY
    assert law_of("A*u", "A*v").of_known_parts and not law_of("A*u", "A*v").known and law_of("A*u").known
    assert not law_of("A*u", "A*q**3").of_known_parts


def test_parts_and_motors_of_joints(search):
    context, state = search
    assert [c.target for c in taken_apart(context, state.candidates[0])] == ["shoulder", "elbow"]
    assert taken_apart(context, next(c for c in context.candidates if c.target == "elbow")) == []
    assert motors_of(context.sim.model, "elbow") == ["e"]


def test_a_shared_gain_and_its_opposite_on_one_motor_are_a_gain_of_the_other():
    weak = NOMINAL.replace('joint="shoulder"/>', 'joint="shoulder" gear="0.7"/>')
    context, state = begin_search(mujoco.MjSpec.from_string(NOMINAL), record(weak), threads=1)
    both, elbow = (next(c for c in context.candidates if c.label == f"actuator_gain({t})") for t in ("*", "e"))
    found = (AcceptedEffect(0, both, np.array([0.7])), AcceptedEffect(1, elbow, np.array([1 / 0.7])))
    state = refit_accepted(context, replace(state, accepted=found))
    assert labels(single_for_shared(context, state)) == ["actuator_gain(s)"]
    alone = replace(state, accepted=found[:1])
    assert single_for_shared(context, alone) is alone, "a shared one alone is not taken apart"


def test_rounds_that_follow_are_none_that_an_accepted_effect_has(search):
    _, state = search
    later = replace(state, accepted=(*state.accepted, replace(state.accepted[0], round=7)))
    assert next_round((), later) == 8 and next_round((), replace(state, accepted=())) == 0
