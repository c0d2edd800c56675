"""Source images in poses that no motion brings about, for what reads states to learn from.

In motion the components of a state go together: a falling pole's cart runs the other way. What reads states off images
then learns to tell the one from the other, and is wrong wherever they part, as they do in a target that moves
differently. A simulator can be put into any pose, so here it is: along recorded motions, with every joint moved on its
own. Nothing of the target takes part.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from datamodules.unpaired import read_all
from idapt_pl.envs import VectorImageEnv
from idapt_pl.stages.context import StageContext

KNOT = 10
"""Control steps in which joints go from one offset to the next, at one speed, which is added to their velocities."""


def moved_poses(c: StageContext, step: int, source: Sequence[Path]) -> list[Path]:
    """``moved.h5``: images and states of the source in poses around its recorded ones; none without ``poses.spread``.

    Args:
        c: of the run.
        step: grounding step.
        source: trajectory files with states and simulations.
    """
    if not c.poses.spread:
        return []

    def make(seed: int) -> Trajectories:
        recorded, rng = read_all(source, also="simulation"), np.random.default_rng(seed)
        with closing(c.worlds.source(1)) as env:
            episodes = move(env, recorded.episodes, c.poses.spread, c.poses.images, rng)
        return replace(recorded, episodes=tuple(episodes), source=f"{recorded.source}, with every joint moved")

    return [c.stages.record(step, "moved", make)[0]]


def move(
    env: VectorImageEnv, recorded: Sequence[Episode], spread: float, images: int, rng: np.random.Generator
) -> list[Episode]:
    """Recorded episodes in a random order, each joint a little elsewhere, until there are so many images.

    Args:
        env: one simulation of the source.
        recorded: episodes with the ``simulation`` at each observation.
        spread: of the offsets, in units of each joint's own spread over all that was recorded.
        images: at least; fewer if nothing is left.
        rng: draws order and offsets.
    """
    env.reset(seed=int(rng.integers(2**31)))
    rows = np.concatenate([e.observations["simulation"] for e in recorded])
    scale = spread * joint_spread(env.model, np.array([env.restore(0, row).qpos.copy() for row in rows]))
    for name in env.task.unseen:
        scale[env.model.joint(name).dofadr] = 0.0  # nothing depends on where it is
    found, taken = [], 0
    for i in rng.permutation(len(recorded)):
        if taken >= images:
            break
        found.append(moved_episode(env, recorded[i], scale, rng))
        taken += len(found[-1]) + 1
    return found


def joint_spread(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Standard deviation of every degree of freedom, (nv,), over positions (n, nq)."""
    from_first = np.zeros((len(qpos), model.nv))
    for difference, q in zip(from_first, qpos, strict=True):
        mujoco.mj_differentiatePos(model, difference, 1.0, qpos[0], q)
    return from_first.std(0)


def moved_episode(env: VectorImageEnv, episode: Episode, scale: np.ndarray, rng: np.random.Generator) -> Episode:
    """An episode with offsets of this spread (nv,) on its joints, seen again.

    Actions stay, though nothing moves so by them: these are images with states, and no motions.
    """
    offsets, speeds = wandering(len(episode) + 1, env.dt, scale, rng)
    frames, states = [], []
    for row, offset, speed in zip(episode.observations["simulation"], offsets, speeds, strict=True):
        data = env.restore(0, row)
        elsewhere = data.qpos.copy()
        mujoco.mj_integratePos(env.model, elsewhere, offset, 1.0)
        frames.append(env.set_state(0, elsewhere, data.qvel + speed))
        states.append(env.states()[0])
    return Episode(episode.actions, {"pixels": np.asarray(frames), "state": np.asarray(states)})


def wandering(frames: int, dt: float, scale: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (frames, nv) that go straight from knot to knot, and their rates; at rest at first, as episodes begin.

    A rate is what has brought an offset about, as a simulation's velocities are, and as the frames so far show it.
    """
    knots = rng.normal(size=(frames // KNOT + 3, len(scale))) * scale
    knots[1] = knots[0]
    slopes = np.diff(knots, axis=0) / (KNOT * dt)
    piece, along = np.divmod(np.arange(frames), KNOT)
    return knots[piece] + slopes[piece] * along[:, None] * dt, slopes[np.maximum(np.arange(frames) - 1, 0) // KNOT]
