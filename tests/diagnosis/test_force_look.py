"""Many candidates are ordered by the forces that they add, much as simulating each of them would."""

import mujoco
import numpy as np
import pytest
from arm import ARM, found, record

from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds import screening
from idapt_pl.diagnosis.rounds.force_look import acts_as_force, responses_by_forces
from idapt_pl.diagnosis.rounds.screening import ScoreTest, screen_candidates
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS
from idapt_pl.effects.joints import JointBacklash, JointDamping

GAIN = ARM.replace('<motor name="s" joint="shoulder"', '<motor name="s" gear="0.8" joint="shoulder"')


@pytest.fixture(scope="module")
def search():
    """A search that has just begun, on recordings of an arm with a weak motor."""
    spec = mujoco.MjSpec.from_string(ARM)
    return begin_search(spec, record(GAIN), (), None, None, None, 0, DEFAULT_SETTINGS, lambda *a: None, 1, (), None)


def test_a_model_needs_no_forces_besides_its_own_to_move_as_it_does(search):
    context, state = search
    windows = state.windows.scout.windows
    states = context.sim.mean_states((), windows)
    lacking, qacc = context.sim.inverse_dynamics((), windows, states)
    assert lacking == pytest.approx(0, abs=1e-9)
    with_damping = (JointDamping("elbow", 0.05),)
    more = context.sim.inverse_dynamics(with_damping, windows, states, qacc)[0]
    nq = context.sim.model.nq
    expected = np.stack([np.zeros(len(states)), (0.05 - 0.02) * states[:, 2 + nq]], 1)
    assert more == pytest.approx(expected, abs=1e-9), "what damping takes away, something else must give"


def test_responses_are_much_as_they_are_when_simulated(search):
    context, state = search
    split = state.windows.scout
    respond, simulated = responses_by_forces(context, state, split), ScoreTest(context, state, split)
    kinds = {}
    for c in filter(acts_as_force, context.candidates):
        x = np.array(c.nominal) + 0.05 * np.array(c.scale)
        one, other = respond(c.effect(x)).ravel(), simulated.response(c.effect(x))
        if np.linalg.norm(other) > 0.1:
            kinds.setdefault(c.kind.name, []).append(np.corrcoef(one, other)[0, 1])
    assert len(kinds) >= 10
    poor = {k: v for k, v in kinds.items() if min(v) < 0.8}
    assert not poor


def test_the_best_of_many_are_simulated_and_the_rest_is_not(search, monkeypatch):
    context, state = search
    everything = screen_candidates(context, state, 0)
    monkeypatch.setattr(screening, "MANY", 0)
    monkeypatch.setattr(screening, "SIMULATED", 5)
    monkeypatch.setattr(screening, "MISSED", 1.0)
    few = screen_candidates(context, state, 0)
    assert few[0].candidate == everything[0].candidate and few[0].score == pytest.approx(everything[0].score)
    assert {t.candidate for t in few} == {t.candidate for t in everything}, "each has a score, if a rough one"


def test_where_the_order_misses_one_all_are_simulated(search, monkeypatch):
    context, state = search
    everything = screen_candidates(context, state, 0)
    monkeypatch.setattr(screening, "MANY", 0)
    monkeypatch.setattr(screening, "SIMULATED", 3)
    monkeypatch.setattr(
        screening, "responses_by_forces", lambda *a: lambda effect: np.zeros_like(state.windows.scout.W[..., 0])
    )
    again = screen_candidates(context, state, 0)
    assert [(t.candidate, pytest.approx(t.score)) for t in again] == [(t.candidate, t.score) for t in everything]


def test_a_hidden_gain_is_named_with_it(monkeypatch):
    monkeypatch.setattr(screening, "MANY", 0)
    monkeypatch.setattr(screening, "SIMULATED", 10)
    diagnosis, effects = found(record(GAIN))
    assert (diagnosis.verdict, set(effects)) == ("effects_found", {("actuator_gain", "s")})


def test_what_is_no_force_is_always_simulated(search):
    left = {c.kind.name for c in search[0].candidates if not acts_as_force(c)}
    assert {"sensor_bias", "sensor_gain", "actuator_delay", "actuator_lag", JointBacklash.name} <= left
