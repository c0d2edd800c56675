"""Laws see commands as they arrive at the motors: the same in replays and in environments."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.rounds.force_response import measured_signals_of, term_values
from idapt_pl.effects import Domain
from idapt_pl.effects.acting import advance
from idapt_pl.effects.learned import LearnedForce
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.prediction.data import Windows, as_recordings
from idapt_pl.prediction.simulator import Simulator

ROD = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody><body name="rod"><joint name="axis" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="1"/></body></worldbody>
  <actuator><motor name="axis" joint="axis" {own}/></actuator>
</mujoco>"""
STEPS, SKIP = 60, 10
LAW, BY_MOTOR = LearnedForce("axis", "a*u*abs(u)", a=0.8), LearnedForce("axis", "a*motor*abs(v)", a=1.0)
DELAY, LAG = ActuatorDelay("axis", 0.03), ActuatorLag("axis", 0.05, 0.001)
"""Where the model begins a step, its filter has come half a time step less far than in the mean over it."""


def played(xml, *effects):
    """What a rod does in an environment under random commands, after one at rest."""
    model = Domain("d", lambda: mujoco.MjSpec.from_string(xml), effects).compile()
    data, actions = mujoco.MjData(model), np.random.default_rng(0).uniform(-1, 1, (STEPS, 1))
    actions[0], q, v = 0, [data.qpos.copy()], [data.qvel.copy()]
    for a in actions:
        data.ctrl[:] = a
        advance(model, data, SKIP)
        q.append(data.qpos.copy()), v.append(data.qvel.copy())
    return Trajectories((Episode(actions, {"qpos": np.array(q), "qvel": np.array(v)}),), SKIP * 0.002)


def simulator(xml, seen):
    spec = mujoco.MjSpec.from_string(xml)
    data, velocities = as_recordings(spec.copy().compile(), seen)
    return Simulator(spec, data, velocities, threads=1)


def replayed(xml, seen, *effects):
    """Angles of the rod in the replay of a diagnosis."""
    return simulator(xml, seen).predict(effects, Windows(np.zeros(1, int), np.zeros(1, int), np.arange(1, STEPS + 1)))[
        0
    ][0, :, 0]


@pytest.mark.parametrize("effects", [(), (DELAY,), (LAG,), (DELAY, LAG)], ids=["plain", "delay", "lag", "both"])
@pytest.mark.parametrize("law", [LAW, BY_MOTOR], ids=["u", "motor"])
def test_a_law_of_commands_acts_in_environments_when_it_does_in_replays(law, effects):
    seen = played(ROD.format(own=""), *effects, law)
    angles, right = seen.episodes[0].observations["qpos"][1:, 0], replayed(ROD.format(own=""), seen, *effects, law)
    assert np.abs(angles - right).max() < 2e-3 < 0.05 < np.abs(angles).max()
    without = replayed(ROD.format(own=""), seen, *effects)
    assert np.abs(angles - without).max() > 0.02, "the law matters"


@pytest.mark.parametrize(
    "own",
    [
        'delay="0.02" nsample="11"',
        'dyntype="filterexact" dynprm="0.05"',
        'dyntype="filter" dynprm="0.05" actearly="true"',
    ],
)
def test_so_does_one_behind_what_the_actuator_does_itself(own):
    xml = ROD.format(own=own).replace("<motor", "<general")
    seen = played(xml, LAW)
    assert seen.episodes[0].observations["qpos"][1:, 0] == pytest.approx(replayed(xml, seen, LAW), abs=1e-3)


def proposed(xml, formula, *effects):
    """What a term is taken to be in the steps of a window before it is simulated, and the commands recorded there."""
    seen = played(xml, *effects)
    context = SimpleNamespace(sim=simulator(xml, seen), steps=8)
    windows = Windows(np.zeros(1, int), np.array([20]), np.array([8]))
    (signals,) = measured_signals_of(context, effects, windows, [0])
    return term_values(context, effects, windows, signals, formula)[0], seen.episodes[0].actions[:, 0]


def test_terms_are_proposed_by_commands_as_they_arrive():
    late, u = proposed(ROD.format(own=""), "u", ActuatorDelay("axis", 0.04))
    assert late == pytest.approx(u[18:26])
    motor, u = proposed(ROD.format(own=""), "motor", ActuatorDelay("axis", 0.04))
    assert motor == pytest.approx(u[18:26])
    slow, u = proposed(ROD.format(own=""), "lowpass(u, 1e-6)", ActuatorDelay("axis", 0.04))
    assert slow == pytest.approx(0.5 * (u[17:25] + u[18:26]), abs=1e-6)  # at a sample, and in the middle of steps


def test_the_force_of_an_actuator_with_a_state_is_seen_too():
    motor, u = proposed(ROD.format(own='dyntype="integrator"').replace("<motor", "<general"), "motor")
    assert motor == pytest.approx(0.02 * np.cumsum(np.append(0, u))[20:28], abs=1e-6)
