"""Velocities learned from simulations whose dynamics vary: near the truth whatever the dynamics, unlike slopes."""

import numpy as np
import pytest

from idapt_pl.diagnosis.data import slopes
from idapt_pl.domains.effects import ACTUATED, JointArmature
from idapt_pl.envs import VectorStateEnv
from idapt_pl.rollout import EXPLORATION
from idapt_pl.tasks import make_task
from idapt_pl.velocities import VelocityReader, learn_velocities, other_dynamics, play

TASK = make_task("half_cheetah")
SOURCE = TASK.domain("source")
NOISE = 0.03


@pytest.fixture(scope="module")
def commands():
    env = VectorStateEnv(TASK, SOURCE)
    act = EXPLORATION["babble"](env, 0)
    return [np.array([act(np.zeros((1, 1)))[0] for _ in range(100)]) for _ in range(6)]


@pytest.fixture(scope="module")
def reader(commands):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("idapt_pl.velocities.STEPS", 6000)
        patch.setattr("idapt_pl.velocities.BATCHES", 1500)
        return learn_velocities(TASK, SOURCE, commands, np.full(9, NOISE), 0)


@pytest.mark.parametrize("armature", [0.1, 0.4])
def test_velocities_are_near_the_truth_for_dynamics_that_the_source_has_not(reader, commands, armature):
    """Mean absolute errors in units of the speeds' spread; central slopes of exact positions for comparison."""
    rng, model = np.random.default_rng(1), SOURCE.compile()
    read, sloped = [], []
    for k, a in enumerate(commands):
        motion = play(TASK, SOURCE.with_effects(JointArmature(ACTUATED, armature)), a, 50 + k)
        seen = reader.misread(motion.qpos, np.full(9, NOISE), rng)
        spread = motion.qvel.std(0)
        read.append(np.abs(reader.read(seen, motion.actions) - motion.qvel).mean(0) / spread)
        time = 0.1 * np.arange(len(seen))
        sloped.append(np.abs(slopes(model, time, motion.qpos) - motion.qvel).mean(0) / spread)
    read, sloped = np.mean(read, 0)[1:], np.mean(sloped, 0)[1:]
    assert np.median(read) < 0.4 and np.median(read) < 0.7 * np.median(sloped), f"{read}, slopes {sloped}"


def test_a_reader_is_the_same_for_a_seed_and_another_for_another(commands, monkeypatch):
    monkeypatch.setattr("idapt_pl.velocities.STEPS", 300)
    monkeypatch.setattr("idapt_pl.velocities.BATCHES", 20)
    motion = play(TASK, SOURCE, commands[0], 0)
    one, same, other = (
        learn_velocities(TASK, SOURCE, commands, np.full(9, NOISE), s).read(motion.qpos, motion.actions)
        for s in (0, 0, 1)
    )
    assert np.array_equal(one, same) and not np.allclose(one, other)


def test_where_along_the_track_and_how_often_turned_make_no_difference(reader, commands):
    motion = play(TASK, SOURCE, commands[0], 0)
    moved = motion.qpos + np.eye(9)[0] * 100 + np.eye(9)[2] * 2 * np.pi
    assert reader.read(moved, motion.actions) == pytest.approx(reader.read(motion.qpos, motion.actions), abs=1e-2)


def test_sources_differ_in_motors_friction_and_a_mass():
    rng, model = np.random.default_rng(0), SOURCE.compile()
    drawn = [other_dynamics(model, rng) for _ in range(30)]
    compiled = [SOURCE.with_effects(*effects).compile() for effects in drawn]
    dof = model.joint("bthigh").dofadr[0]
    armature = [m.dof_armature[dof] for m in compiled]
    assert max(armature) / min(armature) > 10
    assert np.ptp([m.actuator_gainprm[0, 0] for m in compiled]) > 0.5
    assert sum(m.dof_frictionloss[dof] > 0 for m in compiled) in range(5, 26), "in about half of them"
    assert all(np.sum(m.body_mass != model.body_mass) <= 1 for m in compiled)
    assert all(m.dof_armature[0] == model.dof_armature[0] for m in compiled), "the track has no motor"


def test_joints_whose_positions_are_made_up_are_not_looked_at():
    model = SOURCE.compile()
    assert VelocityReader(model, ("rootx",)).dofs.tolist() == list(range(1, 9))
    assert VelocityReader(model, ()).dofs.tolist() == list(range(9))
