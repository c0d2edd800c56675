"""Stops that recordings show, and what a diagnosis makes of them."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from datamodules.trajectories import Episode, Trajectories
from idapt_pl.diagnosis.candidates.stops_shown import HARDER, is_pushed_back, stops_shown, unexplained_accelerations
from idapt_pl.diagnosis.rounds.measurement import with_interval, worse_from
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.prediction.data import Recording
from idapt_pl.prediction.simulator import Simulator

LINK = """<mujoco><compiler angle="radian"/><option timestep="0.002"/>
<worldbody><body name="link"><joint name="hip" axis="0 1 0" damping="0.05" {}/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="1" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="hip" joint="hip" ctrlrange="-2 2"/></actuator></mujoco>"""


def recorded(own="", episodes=12, seed=0, pace=8):
    """A link with or without ends under random torques, held for ``pace`` control steps, without noise."""
    model, rng, made = mujoco.MjModel.from_xml_string(LINK.format(own)), np.random.default_rng(seed), []
    data = mujoco.MjData(model)
    for k in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[0] = rng.uniform(-0.3, 0.5)
        actions = np.repeat(rng.uniform(-1.5, 1.5, 96 // pace + 1), pace)[:96, None]
        states = [[data.qpos[0], data.qvel[0]]]
        for action in actions:
            data.ctrl[:] = action
            mujoco.mj_step(model, data, 10)
            states.append([data.qpos[0], data.qvel[0]])
        q, v = np.array(states).T[:, :, None]
        made.append(Recording(f"episode_{k}", 0.02 * np.arange(len(q)), q, v, actions))
    return model, made


def simulator(data, own=""):
    return Simulator(mujoco.MjSpec.from_string(LINK.format(own)), data, True, threads=1)


def test_a_joint_that_runs_into_a_stop_shows_it():
    _, data = recorded('range="-0.4 3"')
    lower, upper = stops_shown(simulator(data))[0]
    assert -0.5 < lower < -0.39 and np.isnan(upper)


def test_a_joint_that_turns_round_by_itself_shows_none():
    assert np.isnan(stops_shown(simulator(recorded()[1]))).all()


def test_a_joint_that_goes_beyond_the_models_end_shows_where_it_went():
    _, data = recorded()
    furthest = min(float(r.qpos.min()) for r in data)
    assert stops_shown(simulator(data, 'range="-0.2 3"'))[0] == pytest.approx([furthest, np.nan], nan_ok=True)


def test_a_servo_that_leans_on_a_stop_slowly_shows_it():
    """It is there for long, and is never fast: the torque is what tells."""
    _, data = recorded('range="-0.4 3"', pace=40)
    lower, upper = stops_shown(simulator(data))[0]
    assert -0.5 < lower < -0.39 and np.isnan(upper)


def test_a_push_back_is_one_that_nothing_elsewhere_comes_near():
    q, back = np.linspace(0, 1, 101), np.tile([1.0, -1.0, 0.5], 34)[:101]
    assert not is_pushed_back(q, back, 0.94)
    assert is_pushed_back(q, np.where(q == 0.97, HARDER + 0.1, back), 0.94), "once"
    assert not is_pushed_back(q, np.where(q == 0.97, -HARDER - 0.1, back), 0.94), "not outward"
    assert not is_pushed_back(q, np.where(q == 0.5, HARDER + 0.1, back), 0.94), "not on its way"
    assert not is_pushed_back(q, back, 1.0) and not is_pushed_back(q, back, -1.0), "no end, or nothing else"


def test_the_right_model_leaves_next_to_nothing_unexplained():
    data = recorded()[1]
    at, rest = unexplained_accelerations(simulator(data), ())
    moved = np.concatenate([np.diff(r.qvel, axis=0) / 0.02 for r in data])
    assert at.shape == rest.shape == moved.shape and np.abs(rest).mean() < 1e-6 * np.abs(moved).mean()


def test_a_stop_stands_out_once_what_else_is_missing_is_known():
    """An arm that is ten times as heavy moves otherwise everywhere."""
    _, data = recorded('range="-0.4 3"')
    light = Simulator(
        mujoco.MjSpec.from_string(LINK.format("").replace('mass="1"', 'mass="0.1"')), data, True, threads=1
    )
    assert np.isnan(stops_shown(light)).all()
    lower, upper = stops_shown(light, (BodyMass("link", mass=1.0),))[0]
    assert -0.5 < lower < -0.39 and np.isnan(upper)


def test_steps_that_are_left_out_show_nothing():
    _, data = recorded('range="-0.4 3"')
    marked = [replace(r, left_out=r.qpos[1:, 0] < -0.3) for r in data]
    assert np.isnan(stops_shown(simulator(marked))).all()


def diagnosed(data, own="", **options):
    spec = mujoco.MjSpec.from_string(LINK.format(own))
    rng = np.random.default_rng(1)
    episodes = []
    for r in data:
        seen = {
            "qpos": r.qpos + 5e-4 * rng.normal(size=r.qpos.shape),
            "qvel": r.qvel + 5e-3 * rng.normal(size=r.qvel.shape),
        }
        episodes.append(Episode(r.actions.astype(np.float32), seen))
    return diagnose(spec, Trajectories(tuple(episodes), 0.02), **options).result


@pytest.mark.parametrize("stop", [-0.4, -0.6])
def test_a_stop_that_the_model_lacks_is_found_and_nothing_besides(stop):
    """The further one is met in few windows of the held-out episodes."""
    found = diagnosed(recorded(f'range="{stop} 3"')[1]).effects
    (effect,) = [e for e in found if e.effect != "numerics"]
    assert (effect.effect, effect.target) == ("joint_range", "hip")
    at = effect.parameters["lower"]
    assert at.estimate == pytest.approx(stop, abs=0.005) and at.nominal is None


def named(result):
    return sorted((e.effect, e.target) for e in result.effects if e.effect != "numerics")


def test_a_stop_beside_another_effect_is_found_and_nothing_besides():
    _, data = recorded('range="-0.5 3" frictionloss="0.3"')
    assert named(diagnosed(data)) == [("joint_frictionloss", "hip"), ("joint_range", "hip")]


def test_a_stop_that_no_held_out_episode_meets_is_found():
    """Judged by halves of the others."""
    _, data = recorded('range="-0.6 3" frictionloss="0.1"', episodes=16)
    met = [k for k, r in enumerate(data) if r.qpos.min() < -0.59]
    calm = [k for k in range(16) if k not in met]
    assert len(met) >= 3 and len(calm) >= 4
    found = diagnosed(data, fit=[*met, *calm[4:]], hold_out=calm[:4])
    assert named(found) == [("joint_frictionloss", "hip"), ("joint_range", "hip")]
    assert "No held-out episode shows joint_range(hip)" in found.next_experiment
    assert any(f"record more like episode_{k} at" in found.next_experiment for k in met)


def test_a_stop_that_is_not_there_is_found_to_be_further_out():
    """The joint goes through it and never meets another, so where that may be is open on one side."""
    data = recorded()[1]
    furthest = min(float(r.qpos.min()) for r in data)
    (effect,) = [e for e in diagnosed(data, 'range="-0.3 3"').effects if e.effect != "numerics"]
    assert (effect.effect, effect.target) == ("joint_range", "hip")
    at = effect.parameters["lower"]
    assert at.ci95 is not None and at.ci95[0] == -13 and at.ci95[1] == pytest.approx(at.estimate)
    assert furthest - 0.05 < at.estimate < -0.6


def test_where_nothing_is_hidden_no_stop_is_found():
    assert not [e for e in diagnosed(recorded('range="-0.4 3"')[1], 'range="-0.4 3"').effects if e.effect != "numerics"]


def with_losses(loss_at):
    """A search that accepted a lower end of -2 in place of -1, where windows lose ``loss_at(end)``."""
    end = Candidate(JointRange, "hip", ("lower",), (-1.0,), (0.1,), plausible=((-13.0, 13.0),))
    state = SearchState((), (AcceptedEffect(0, end, np.array([-2.0])),), SimpleNamespace(fit=None))
    noise = 0.1 * np.random.default_rng(0).normal(size=100)
    context = SimpleNamespace(loss=lambda windows, effects: noise + loss_at(effects[0].lower))
    return context, state


def test_an_open_interval_ends_where_the_fit_gets_worse():
    context, state = with_losses(lambda end: np.full(100, float(end > -1.5)) * np.arange(100) / 100)
    edge = worse_from(context, state, 0, np.array([np.inf]))
    assert edge == pytest.approx(-1.5, abs=0.01) and edge <= -1.5
    measured = with_interval(state.accepted[0], np.array([np.inf]), 0.002, edge)
    assert measured.x == pytest.approx([edge]) and measured.interval.tolist() == [[-13.0, edge]]
    assert not measured.unsure
    assert worse_from(context, state, 0, np.array([0.1])) == pytest.approx(edge), "its slope is that of one side"


def test_a_stop_that_is_met_has_an_interval_of_its_own():
    """Further out is worse, too."""
    context, state = with_losses(lambda end: np.full(100, float(abs(end + 2) > 0.5)) * np.arange(100) / 100)
    assert worse_from(context, state, 0, np.array([0.1])) is None


def test_a_stop_that_is_nearer_than_in_the_model_was_met():
    context, state = with_losses(lambda end: np.zeros(100))
    nearer = replace(state, accepted=(replace(state.accepted[0], x=np.array([-0.5])),))
    assert worse_from(context, nearer, 0, np.array([0.1])) is None


def test_where_the_models_own_value_does_as_well_nothing_is_known():
    context, state = with_losses(lambda end: np.zeros(100))
    assert worse_from(context, state, 0, np.array([np.inf])) is None
    assert with_interval(state.accepted[0], np.array([np.inf]), 0.002, None).unsure
