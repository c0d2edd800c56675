"""States of recordings: found again where they are known, and told to be lost where physics and readings disagree."""

from dataclasses import replace

import numpy as np
import pytest

from idapt_pl.effects.bodies import BodyMass
from idapt_pl.envs import VectorStateEnv
from idapt_pl.smoothing import (
    EnsembleFilter,
    ReadRecording,
    RecordingSmoother,
    SimulatedEnsemble,
    most_that_is_bearable,
    reading_model,
    smooth_episode,
)
from idapt_pl.smoothing.ensemble import with_longer_steps
from idapt_pl.tasks import make_task


@pytest.fixture(scope="module")
def task():
    return make_task("half_cheetah")


def played(task, domain, steps, seed):
    """States (T+1, s) and actions (T, nu) of slow random actions."""
    rng = np.random.default_rng(seed)
    env = VectorStateEnv(task, domain, 1)
    obs, _ = env.reset(seed=seed)
    states, actions, action = [obs["state"][0]], [], np.zeros(6)
    for _ in range(steps):
        action = np.clip(0.7 * action + 0.6 * rng.normal(size=6), -1, 1)
        states.append(env.step(action[None].astype(np.float32))[0]["state"][0])
        actions.append(action)
    env.close()
    return np.asarray(states, float), np.asarray(actions)


@pytest.fixture(scope="module")
def recording(task):
    """True states, and what a sensor reads of them with errors of a tenth of their spread."""
    states, actions = played(task, task.domain("source"), 60, 3)
    error = 0.25 * states.std(0)
    readings = states + error * np.random.default_rng(4).normal(size=states.shape)
    return states, error, ReadRecording(readings, actions)


def expected_of(task, states, error):
    rng = np.random.default_rng(5)
    rows = np.repeat(states, 4, 0)
    return reading_model(task, task.domain("source"), rows + error * rng.normal(size=rows.shape), rows)


def relative(error, states):
    return float(np.mean(np.abs(error) / states.std(0)))


def test_errors_of_readings_are_measured(task, recording):
    states, error, _ = recording
    np.testing.assert_allclose(expected_of(task, states, error).error, error, rtol=0.25)


def test_physics_takes_most_of_the_readings_errors_off(task, recording):
    states, error, read = recording
    expected = expected_of(task, states, error)
    smoothed = RecordingSmoother(task, task.domain("source"), expected, 64, 6)([read], 0)[0]
    before, after = relative(read.readings - states, states), relative(smoothed.states - states, states)
    assert after < 0.6 * before
    assert not smoothed.lost.any() and smoothed.surprise.shape == states.shape
    ahead = RecordingSmoother(task, task.domain("source"), expected, 64, 0)([read], 0)[0]
    assert after < relative(ahead.states - states, states), "what comes later tells something too"


def test_physics_of_another_robot_helps_less(task, recording):
    states, error, read = recording
    expected = expected_of(task, states, error)
    heavy = task.domain("source").with_effects(BodyMass("torso", 30.0))
    right, wrong = (
        RecordingSmoother(task, domain, expected, 64, 6)([read], 0)[0] for domain in (task.domain("source"), heavy)
    )
    assert np.abs(wrong.surprise / states.std(0)).mean() > 1.1 * np.abs(right.surprise / states.std(0)).mean()


def test_states_are_best_where_readings_are_taken_to_be_as_wrong_as_they_are(task, recording):
    states, error, read = recording
    expected = expected_of(task, states, error)
    scale = states.std(0)
    optimist = replace(expected, error=expected.error / 4)  # as if source frames were read four times as well
    for assumed, low, high in ((expected, 1, 1.5), (optimist, 3, 6)):
        smooth = RecordingSmoother(task, task.domain("source"), assumed, 64, 3)
        errors = smooth.state_errors([read], [states], scale, 0)
        assert low <= min(errors, key=errors.__getitem__) <= high
        assert min(errors.values()) < np.abs((read.readings - states) / scale).mean()


def test_readings_get_as_little_weight_as_costs_little_where_states_are_known():
    assert most_that_is_bearable({1.0: 0.10, 2.0: 0.11, 4.0: 0.12, 9.0: 0.13}) == 4.0
    assert most_that_is_bearable({1.0: 0.10, 2.0: 0.20, 4.0: 0.11}) == 4.0
    assert most_that_is_bearable({1.0: 0.10, 2.0: 0.20, 4.0: 0.30}) == 1.0


def test_errors_that_stay_for_long_need_a_larger_factor(task, recording):
    """Where episodes begin is known, and readings of the target's images are off alike from one to the next."""
    states, error, read = recording
    off = ReadRecording(states + 2 * error, read.actions).first(20)
    known = RecordingSmoother(task, task.domain("source"), expected_of(task, states, error), 64, 6, 1, states[:1])
    errors = known.state_errors([off], [states[:21]], states.std(0), 0)
    assert errors[9.0] < 0.6 * errors[1.0]


def test_where_readings_jump_the_state_is_lost_and_found_again(task, recording):
    states, error, read = recording
    error = error / 5
    shown, actions = states.copy(), read.actions.copy()
    shown[30:], actions[30:] = states[:31], actions[:30]  # all at once it is where it was when it began
    readings = shown + error * np.random.default_rng(0).normal(size=shown.shape)
    ensemble = SimulatedEnsemble(task, task.domain("source"), 64)
    known = EnsembleFilter(ensemble, expected_of(task, states, error), 6, seed=0)
    found = smooth_episode(known, readings, actions)
    assert np.flatnonzero(found.lost).tolist() == [30]
    assert relative(found.states - shown, states) < relative(readings - shown, states)


def test_a_reading_that_guesses_are_drawn_about_counts_once(task, recording):
    states, error, _ = recording
    expected = expected_of(task, states, error)
    known = EnsembleFilter(SimulatedEnsemble(task, task.domain("source"), 2000), expected, 6, seed=0)
    known.begin(states[10])
    known.take_in(states[10])
    spread = known.past[-1].std(0)
    np.testing.assert_allclose(spread, expected.error, rtol=0.1)


def biased(task, recording):
    """What a sensor reads that is off by half a spread, everywhere alike."""
    states, error, read = recording
    wrong = 0.5 * states.std(0) * np.sign(np.random.default_rng(6).normal(size=states.shape[1]))
    return states, expected_of(task, states, error), ReadRecording(read.readings + wrong, read.actions)


def test_a_known_start_takes_an_offset_off_the_first_states(task, recording):
    states, expected, read = biased(task, recording)
    unknown = RecordingSmoother(task, task.domain("source"), expected, 64, 6)
    known = replace(unknown, starts=states[:1] + 0.005 * np.random.default_rng(7).normal(size=(20, 17)))
    first = slice(0, 15)
    errors = [relative((s([read], 0)[0].states - states)[first], states) for s in (known, unknown)]
    assert errors[0] < 0.6 * errors[1]


def test_a_start_that_readings_are_far_from_is_not_believed(task, recording):
    states, error, read = recording
    expected, elsewhere = expected_of(task, states, error), states[:1] + 8 * states.std(0)
    smooth = RecordingSmoother(task, task.domain("source"), expected, 64, 6)
    found = replace(smooth, starts=elsewhere)([read], 0)[0]
    assert found.lost[0] and not found.lost[1:].any()
    assert relative(found.states - states, states) < 1.2 * relative(smooth([read], 0)[0].states - states, states)


def test_threads_and_neighbours_change_nothing(task, recording):
    states, error, read = recording
    expected, short = expected_of(task, states, error), recording[2].first(12)
    alone = RecordingSmoother(task, task.domain("source"), expected, 16, 3)([short], 0)[0]
    both = RecordingSmoother(task, task.domain("source"), expected, 16, 3, threads=2)([short, read.first(8)], 0)
    np.testing.assert_array_equal(alone.states, both[0].states)
    smooth = RecordingSmoother(task, task.domain("source"), expected, 16, 3)
    np.testing.assert_array_equal(smooth([short], 1)[0].states, smooth([read.first(8), short], 0)[1].states)


def test_longer_steps_bring_a_walker_in_flight_to_the_same_place():
    task = make_task("walker2d")
    model = task.domain("source").compile()
    states, actions = played(task, task.domain("source"), 5, 0)
    quick, longer = with_longer_steps(task, model)
    assert (quick.frame_skip, longer.opt.timestep) == (task.frame_skip / 2, 2 * model.opt.timestep)
    assert quick.period(longer) == pytest.approx(task.period(model))
    begun = states[:1] + np.array([[1.0, *[0.0] * 16]])  # a metre above the floor
    after = []
    for t, m in ((task, model), (quick, longer)):
        ensemble = SimulatedEnsemble(t, task.domain("source"), 1, m)
        ensemble.put(ensemble.begin(begun))
        velocities = ensemble.advance(actions[0])[0, model.nv :]
        after.append(np.concatenate([ensemble.origin, velocities]))
    np.testing.assert_allclose(after[1], after[0], atol=1e-3)
    assert np.abs(after[0][model.nq :]).max() > 1, "it moves"


def test_models_of_other_integrators_keep_their_steps(task):
    model = task.domain("source").compile()
    assert with_longer_steps(task, model) == (task, model)


def test_an_ensemble_that_blew_up_altogether_stays_where_it_was_and_goes_on(task, recording, monkeypatch):
    states = recording[0]
    guesses = SimulatedEnsemble(task, task.domain("source"), 3)
    began = guesses.begin(np.repeat(states[:1], 3, 0))
    guesses.put(began)
    with monkeypatch.context() as patch:
        patch.setattr(type(task), "play", lambda self, model, data, command: data.qvel.fill(np.nan))
        stayed = guesses.advance(np.zeros(6))
    np.testing.assert_allclose(stayed, began, atol=1e-12)
    guesses.put(stayed)
    went_on = guesses.advance(np.zeros(6))
    assert np.isfinite(went_on).all() and not np.allclose(went_on, stayed)


def test_tasks_whose_states_tell_no_positions_say_so():
    task = make_task("fetch_reach")
    with pytest.raises(ValueError, match=r"labels\.members"):
        SimulatedEnsemble(task, task.domain("source"), 2).begin(np.zeros((2, 16)))
