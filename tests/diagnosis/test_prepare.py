"""Which episodes are fitted and which are judged on, and how long the windows are."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.prepare import begin_search, split_episodes
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.horizon import motors_show
from idapt_pl.stretches.stretch import with_marks

sys.path.insert(0, str(ROOT / "tests" / "diagnosis"))
from arm import ARM, record


def test_split_holds_every_fourth_episode_out_and_never_shares():
    fit, held = split_episodes(np.ones(9), None, None)
    assert len(held) >= 2 and sorted([*fit, *held]) == list(range(9))
    assert split_episodes(np.ones(4), None, [1])[0].tolist() == [0, 2, 3]
    with pytest.raises(ValueError, match="both to be fitted and held out"):
        split_episodes(np.ones(4), [0, 1], [1])
    with pytest.raises(ValueError, match="no episode 7"):
        split_episodes(np.ones(4), [7], None)
    with pytest.raises(ValueError, match="at least two are needed"):
        split_episodes(np.ones(1), None, None)


def test_both_parts_have_calm_and_lively_episodes():
    """Recordings often take turns: every fourth in order would hold out one kind of motion."""
    _, held = split_episodes(np.tile([1.0, 2.0, 3.0, 0.1], 4), None, None)
    assert {int(e) % 4 for e in held} == {0, 1, 2, 3}


@pytest.mark.parametrize("fragments", [2, 4])
def test_fragments_are_neither_fitted_nor_held_out(fragments):
    """Gaps in a log leave them: they would be the only ones to judge on, or make all windows as short."""
    data = record(episodes=3)
    first, second, third = data.episodes
    cut = [first.part(k, k + 4) for k in (30, 40, 50, 60)[:fragments]]
    kept = np.arange(len(second)) % 6 == 0  # no window fits between what is left out
    episodes = (first, *cut, second, third, with_marks(second, ~kept))
    context, _ = begin_search(mujoco.MjSpec.from_string(ARM), replace(data, episodes=episodes), threads=1)
    used = sorted([*context.fit_episodes, *context.held_out_episodes])
    assert used == [0, 1 + fragments, 2 + fragments] and context.steps == 5


SLOW = """
<mujoco>
  <option timestep="0.02"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="1"/><geom size="0.1" mass="{mass}"/></body>
  </worldbody>
  <actuator><motor name="push" joint="x" gear="0.1"/></actuator>
</mujoco>"""


def drives(mass, episodes=16, steps=160):
    """A cart that is pushed gently, and seen with noise of half a millimetre."""
    model, rng, made = mujoco.MjModel.from_xml_string(SLOW.format(mass=mass)), np.random.default_rng(0), []
    for _ in range(episodes):
        d, u, rows = mujoco.MjData(model), np.repeat(rng.uniform(-1, 1, (steps // 16, 1)), 16, 0), []
        for a in (*u, u[-1]):
            rows.append([d.qpos[0], d.qvel[0]])
            d.ctrl[:] = a
            mujoco.mj_step(model, d)
        q, v = np.array(rows).T[..., None] + np.array([[[5e-4]], [[5e-3]]]) * rng.normal(size=(2, steps + 1, 1))
        made.append(Episode(u, {"qpos": q, "qvel": v}))
    return Trajectories(tuple(made), 0.02)


def test_windows_are_longer_where_little_shows_of_a_motor_in_short_ones():
    spec = mujoco.MjSpec.from_string(SLOW.format(mass=0.6))
    context, state = begin_search(spec, drives(0.6), threads=1)
    assert context.steps >= 20
    shown = motors_show(context.sim, (), state.windows.noise, context.held_out_episodes, context.steps, 0)
    assert shown > 3 * motors_show(context.sim, (), state.windows.noise, context.held_out_episodes, 5, 0)
    assert motors_show(context.sim, (), state.windows.noise, context.held_out_episodes, 10**4, 0) == 0.0, "no window"
    lively, _ = begin_search(mujoco.MjSpec.from_string(ARM), record(), threads=1)
    assert lively.steps == 5
    effects = diagnose(spec, drives(0.8), threads=1, candidates=["body_mass", "joint_damping"]).report["effects"]
    assert [e["effect"] for e in effects] == ["body_mass"]
    assert effects[0]["parameters"]["mass"]["estimate"] == pytest.approx(0.8, rel=0.05)
