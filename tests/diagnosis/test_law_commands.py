"""Laws see commands as they arrive at the motors: the same in replays and in environments."""

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.data import Windows, as_recordings
from idapt_pl.diagnosis.simulator import Simulator
from idapt_pl.effects import Domain
from idapt_pl.effects.acting import advance
from idapt_pl.effects.learned import LearnedForce
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag

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


def replayed(xml, seen, *effects):
    """Angles of the rod in the replay of a diagnosis."""
    spec = mujoco.MjSpec.from_string(xml)
    data, velocities = as_recordings(spec.copy().compile(), seen)
    sim = Simulator(spec, data, velocities, threads=1)
    return sim.predict(effects, Windows(np.zeros(1, int), np.zeros(1, int), np.arange(1, STEPS + 1)))[0][0, :, 0]


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
