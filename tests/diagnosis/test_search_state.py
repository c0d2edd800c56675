"""A search takes and returns its state; fits of candidates split parameters as they should."""

from dataclasses import FrozenInstanceError, replace

import mujoco
import numpy as np
import pytest
from arm import ARM, DT, record

from idapt_pl.diagnosis.candidates.fit import fit_candidates, split_parameters
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.search import one_round
from idapt_pl.diagnosis.state.search_state import (
    AcceptedEffect,
    SearchState,
    refit_accepted,
    refit_without,
    renew,
    with_its_dead_time,
)
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.bodies import BodyCom
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.least_squares import robust_loss

DAMPING = Candidate(JointDamping, "elbow", ("damping",), (0.0,), (0.1,))
CENTRE = Candidate(BodyCom, "upper", ("x", "y", "z"), (0.0,) * 3, (0.1,) * 3)


@pytest.fixture(scope="module")
def started():
    """A search for hidden damping, before its first round."""
    data = record(ARM.replace('damping="0.02"', 'damping="0.06"'))
    model = mujoco.MjSpec.from_string(ARM)
    return begin_search(model, data, candidates=["joint_damping", "body_mass"], settings=SearchSettings(numerics=False))


def test_a_round_returns_another_state_and_leaves_the_one_before(started):
    context, state = started
    found, trials = one_round(context, state, 0)
    assert state.accepted == () and state.effects == ()
    assert [c.label for c in found.candidates] == ["joint_damping(elbow)"]
    assert len(trials) == len(context.candidates)
    assert [t.candidate.label for t in trials if not t.rejection] == ["joint_damping(elbow)"]
    again, _ = one_round(context, state, 0)
    np.testing.assert_array_equal(again.estimates, found.estimates)


def test_windows_are_whitened_anew_and_kept_while_the_kind_of_model_is_the_same(started):
    context, state = started
    found, _ = one_round(context, state, 0)
    renewed = renew(context, found)
    assert renewed.windows.sensitivity is not state.windows.sensitivity, "another effect, other sensitivities"
    refitted = renew(context, refit_accepted(context, renewed))
    assert refitted.windows.sensitivity is renewed.windows.sensitivity, "another value, the same"
    assert refitted.estimates[0] != found.estimates[0]


def test_what_is_left_about_is_exact_where_it_is_anchored_and_for_a_model_without_finer_steps(started):
    context, state = started
    split, fine = state.windows.scout, Numerics("world", context.sim.model.opt.timestep / 4)
    damping = DAMPING.effect(np.array([0.05]))
    np.testing.assert_array_equal(context.about(split, ())((damping,)), context.whitened(split, (damping,)))
    anchored, exact = context.about(split, (fine,)), context.whitened(split, (fine, damping))
    np.testing.assert_allclose(anchored((fine,)), context.whitened(split, (fine,)), atol=1e-9)
    moved = np.abs(exact - context.whitened(split, (fine,))).max()
    assert 0 < np.abs(anchored((fine, damping)) - exact).max() < 0.1 * moved


FINE = ARM.replace('timestep="0.004"', 'timestep="0.001"')


def test_a_coarse_time_step_does_as_long_as_it_changes_little_of_what_is_left():
    spec, settings = mujoco.MjSpec.from_string(FINE), SearchSettings(numerics=False)

    def step(hidden, noise):
        context, state = begin_search(spec, record(hidden, noise=noise, skip=20), settings=settings)
        return context.coarse_step(state.windows.fit, ())

    heavier = FINE.replace('mass="0.4"', 'mass="0.9"')
    assert step(heavier, (1e-5, 1e-4)) == pytest.approx(DT / 4), "more is missing than that"
    assert step(FINE, (1e-6, 1e-5)) == 0.001, "what the coarse step changes is all that is left"


STOPPED = ARM.replace('name="shoulder"', 'name="shoulder" range="-0.5 0.5"').replace(
    'name="elbow"', 'name="elbow" range="0 0.5" solreflimit="-40000 -20"'
)


@pytest.mark.parametrize(("model", "does"), [(ARM, True), (STOPPED, False)])
def test_a_cheaper_integrator_than_the_models_is_used_unless_differences_grow(model, does):
    """RK4 takes four times as long. Where a stop is hit again and again, another integrator hits it at other times."""
    exact = model.replace('integrator="implicitfast"', 'integrator="RK4"').replace("0.004", "0.01")
    context, state = begin_search(
        mujoco.MjSpec.from_string(exact), record(exact, size=3.0, steps=160, skip=2), threads=1,
        settings=SearchSettings(numerics=False),
    )  # fmt: skip
    split, damped = state.windows.fit, (DAMPING.effect([0.1]),)
    step = context.coarse_step(split, ())
    assert step == (0.01 if does else 0.0)
    swapped = context.whitened(split, context.with_coarse_numerics(damped, step))
    assert np.array_equal(swapped, context.whitened(split, damped)) == (not does)


def test_a_fit_with_a_coarse_time_step_comes_to_the_same():
    data = record(FINE.replace('damping="0.02"', 'damping="0.06"'), skip=20)
    context, state = begin_search(mujoco.MjSpec.from_string(FINE), data, settings=SearchSettings(numerics=False))
    split = state.windows.fit
    assert context.coarse_step(split, ()) == pytest.approx(DT / 4)
    fit, exact = (context.fit(split, (), [DAMPING], [np.zeros(1)], 6, exact=e) for e in (False, True))
    assert fit.x[0] == pytest.approx(exact.x[0], rel=2e-3)
    there = context.whitened(split, (DAMPING.effect(fit.x[0]),))
    np.testing.assert_array_equal(fit.solution.z, there)
    assert fit.solution.loss == pytest.approx(robust_loss(there).mean())
    assert context.fit(split, (), [CENTRE], [np.zeros(3)], 6, good_enough=1.0).solution.given_up


def test_the_fit_without_an_effect_is_that_of_the_others_or_is_left(started):
    context, state = started
    found = refit_accepted(context, one_round(context, state, 0)[0])
    one, other = found.accepted[0], AcceptedEffect(7, CENTRE, np.zeros(3))
    both = replace(found, accepted=(one, other))
    rest, left = refit_without(context, both, other, good_enough=np.inf)
    assert not left and rest.estimates[0] == pytest.approx(found.estimates[0], rel=1e-3)
    rest, left = refit_without(context, both, one, good_enough=1.0)
    assert left and rest.candidates == [CENTRE], "no centre of mass explains what damping does"


def test_states_cannot_be_changed(started):
    _, state = started
    with pytest.raises(FrozenInstanceError):
        state.fixed = ()


def test_an_effect_is_left_out_by_its_round(started):
    context, state = started
    found, _ = one_round(context, state, 0)
    (only,) = found.accepted
    assert found.without(found.with_estimates([np.array([0.1])]).accepted[0]).accepted == ()
    assert found.without(only).effects == state.effects


def test_parameters_are_split_among_candidates():
    parts = split_parameters([CENTRE, DAMPING], np.arange(4.0))
    assert [p.tolist() for p in parts] == [[0.0, 1.0, 2.0], [3.0]]


def test_a_fit_finds_the_parameters_of_several_candidates():
    """Residuals that are linear in what the effects carry; what is fixed comes first."""
    truth = np.array([0.02, -0.03, 0.01, 0.4])

    def residual(effects):
        fixed, centre, damping = effects
        assert fixed == JointDamping("shoulder", 0.5)
        return 100 * (np.array([centre.x, centre.y, centre.z, damping.damping]) - truth)[None]

    fixed = (JointDamping("shoulder", 0.5),)
    fit = fit_candidates(residual, fixed, [CENTRE, DAMPING], [np.zeros(3), np.zeros(1)], 20)
    assert np.concatenate(fit.x) == pytest.approx(truth, abs=1e-4)
    assert [len(x) for x in fit.x] == [3, 1]


@pytest.mark.parametrize(("target", "dead_time"), [("*", 0.003), ("other", -0.001)])
def test_a_lag_takes_over_the_delay_of_its_commands_that_is_left_out(target, dead_time):
    lag = Candidate(ActuatorLag, "*", ("time_constant", "dead_time"), (0.0, 0.0), (0.01, 0.01))
    late = Candidate(ActuatorDelay, target, ("delay",), (0.0,), (0.01,))
    effects = (AcceptedEffect(0, late, np.array([0.004])), AcceptedEffect(1, lag, np.array([0.03, -0.001])))
    state = SearchState((), (*effects, AcceptedEffect(2, DAMPING, np.array([0.1]))), None)
    rest = with_its_dead_time(state.without(effects[0]), effects[0])
    np.testing.assert_allclose(np.concatenate(rest.estimates), [0.03, dead_time, 0.1])
    rest = with_its_dead_time(state.without(effects[1]), effects[1])
    np.testing.assert_allclose(np.concatenate(rest.estimates), [0.004, 0.1])
