"""Several effects at once: two that help only together, and choices that are reopened until nothing changes."""

from dataclasses import replace

import numpy as np
import pytest
from arm import ARM, found, record
from test_revision import A, B, accepted, context, names

from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.rounds import look_ahead
from idapt_pl.diagnosis.rounds.look_ahead import add_two
from idapt_pl.diagnosis.state.search_state import AcceptedEffect


@pytest.fixture
def as_it_is(monkeypatch):
    """States as they are: the stub of a search has nothing to refit or to whiten."""
    monkeypatch.setattr(look_ahead, "renew", lambda context, state: state)
    monkeypatch.setattr(look_ahead, "refit_accepted", lambda context, state: state)


def search(loss):
    """A search with ``loss``, whose windows of every kind are the same; and a state in which nothing is accepted."""
    state = accepted()
    state.windows.scout = state.windows.held_out
    return context(loss), state


def second(candidate):
    """A round that accepts a candidate on top of whatever is there."""

    def one_round(context, state, round):
        effect = AcceptedEffect(round, candidate, np.array([0.5]))
        return replace(state, accepted=(*state.accepted, effect)), []

    return one_round


def unsure(candidate, loss):
    return Trial(candidate, 0, 1.0, (np.array([0.5]),), rough_loss=loss).rejected(RejectionReason.UNSURE_GAIN, "-")


def test_two_that_help_only_together_are_found(as_it_is):
    both = {("joint_damping", "a"), ("joint_damping", "b")}
    ctx, state = search(lambda effects: 2.0 if both <= effects else 50.0 + 5 * len(effects))
    found, _ = add_two(ctx, state, [unsure(A, 30.0)], second(B), 1)
    assert names(found) == ["joint_damping(a)", "joint_damping(b)"] and [a.round for a in found.accepted] == [0, 1]


def test_two_are_not_added_where_only_one_may_be(as_it_is):
    ctx, state = search(lambda effects: 2.0 if len(effects) == 2 else 50.0)
    assert add_two(ctx, state, [unsure(A, 30.0)], second(B), 1)[0] is not None
    ctx.settings = replace(ctx.settings, max_effects=1)
    assert add_two(ctx, state, [unsure(A, 30.0)], second(B), 1)[0] is None


@pytest.mark.parametrize(
    ("loss", "fitted"),
    [
        (lambda effects: 50.0 + 5 * len(effects), 30.0),  # the second helps no more than the first
        (lambda effects: 5.0 if len(effects) < 2 else 1.0, 3.0),  # little is left: one effect has to do
        (lambda effects: 50.0 if len(effects) < 2 else 1.0, 49.0),  # the first does not help where it is fitted
    ],
)
def test_no_two_are_added_where_they_do_not_surely_help(loss, fitted, as_it_is):
    ctx, state = search(loss)
    assert add_two(ctx, state, [unsure(A, fitted)], second(B), 1)[0] is None


@pytest.mark.slow
def test_effects_that_hide_each_other_are_all_named_and_no_other():
    true = ARM.replace('damping="0.05"', 'damping="0.09" armature="0.02"').replace(
        'damping="0.02"', 'damping="0.02" frictionloss="0.06"'
    )
    _, effects = found(record(true, delay=2, episodes=8), threads=1)
    alike = {"actuator_delay": "actuator_lag", "sensor_delay": "actuator_lag"}
    kinds = sorted((alike.get(e, e), t) for e, t in effects if e != "numerics")
    assert kinds == [
        ("actuator_lag", "*"), ("joint_armature", "shoulder"), ("joint_damping", "shoulder"),
        ("joint_frictionloss", "elbow"),
    ]  # fmt: skip
