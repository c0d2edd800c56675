"""How fast things move, from the positions that a sensor read and the commands that were given.

Two images 0.1 s apart do not tell how fast a leg swings. What an estimator of the state says of it is what was likely
in the source, and slopes of positions that are so far apart are no velocities. So a regression learns it from
simulations: the source with other motors, masses and friction in every episode plays the commands of the recordings,
and positions around a moment, as inexact as the sensor's, and the commands there tell the velocities at it. It knows of
no one dynamics, so it does not argue for the source's.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor, nn

from idapt_pl.diagnosis.data import difference, shift
from idapt_pl.domains import Domain
from idapt_pl.domains.effects import ACTUATED, ActuatorGain, BodyMass, Effect, JointArmature, JointFrictionloss
from idapt_pl.envs import VectorStateEnv
from idapt_pl.nets.mlp import mlp
from idapt_pl.tasks import Task

REACH = 2
"""Control steps to either side of a moment that are looked at."""
STEPS = 20_000
"""Control steps that are simulated, over all episodes."""
COPIES = 3
"""How often each simulated moment is shown, with other errors of its positions."""
BATCHES, BATCH = 2500, 256


@dataclass(frozen=True)
class Motion:
    """Positions (T+1, nq), velocities (T+1, nv) and commands (T, nu) of an episode."""

    qpos: np.ndarray
    qvel: np.ndarray
    actions: np.ndarray


class VelocityReader(nn.Module):
    """Velocities from positions and commands around a moment.

    Args:
        model: whose positions they are.
        unseen: joints whose positions are made up; nothing is read from them.
    """

    def __init__(self, model: mujoco.MjModel, unseen: Sequence[str]) -> None:
        super().__init__()
        self.model = model
        self.dofs = np.array([i for i, j in enumerate(model.dof_jntid) if model.joint(j).name not in unseen])
        one = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
        joints = [j for j in range(model.njnt) if model.jnt_type[j] in one and model.joint(j).name not in unseen]
        turns = [j for j in joints if model.jnt_type[j] == one[0] and not model.jnt_limited[j]]
        self.turning = model.jnt_qposadr[turns]  # angles without an end: an angle and a turn more are the same
        self.others = model.jnt_qposadr[[j for j in joints if j not in turns]]
        size = 2 * len(self.turning) + len(self.others) + 2 * REACH * (len(self.dofs) + model.nu)
        self.net = mlp(size, (256, 256), model.nv, nn.ReLU)
        for name, width in (("mean", size), ("std", size), ("out_mean", model.nv), ("out_std", model.nv)):
            self.register_buffer(name, torch.zeros(width) if "mean" in name else torch.ones(width))

    def around(self, qpos: np.ndarray, actions: np.ndarray) -> Tensor:
        """What is looked at for every moment of an episode, (T+1, size)."""
        index = np.arange(len(qpos))[:, None]
        near = np.clip(index + np.arange(-REACH, REACH + 1), 0, len(qpos) - 1)
        commands = np.clip(index + np.arange(-REACH, REACH), 0, len(actions) - 1)
        moved = difference(self.model, qpos[:, None], qpos[np.delete(near, REACH, 1)])[..., self.dofs]
        angle = qpos[:, self.turning]
        parts = [np.sin(angle), np.cos(angle), qpos[:, self.others], moved.reshape(len(qpos), -1)]
        return torch.from_numpy(np.concatenate([*parts, actions[commands].reshape(len(qpos), -1)], 1)).float()

    def fit(self, motions: Sequence[Motion], noise: np.ndarray, seed: int) -> VelocityReader:
        """Learn from simulated motions whose positions are made as inexact as a sensor's.

        Args:
            motions: simulated.
            noise: standard deviation of the sensor's errors of positions, (nv,).
            seed: of errors, weights and batches.
        """
        rng = np.random.default_rng(seed)
        seen = [m for m in motions for _ in range(COPIES)]
        x = torch.cat([self.around(self.misread(m.qpos, noise, rng), m.actions) for m in seen])
        y = torch.from_numpy(np.concatenate([m.qvel for m in seen])).float()
        for name, values in (("", x), ("out_", y)):
            getattr(self, f"{name}mean").copy_(values.mean(0))
            getattr(self, f"{name}std").copy_(values.std(0).clamp(min=1e-6))
        x, y = (x - self.mean) / self.std, (y - self.out_mean) / self.out_std
        optimizer = torch.optim.Adam(self.net.parameters(), 1e-3, fused=True)
        schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, BATCHES)
        draw = torch.Generator().manual_seed(seed)
        for _ in range(BATCHES):
            rows = torch.randint(len(x), (BATCH,), generator=draw)
            loss = nn.functional.mse_loss(self.net(x[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        return self

    def misread(self, qpos: np.ndarray, noise: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Positions with white errors."""
        return shift(self.model, qpos, rng.normal(size=(len(qpos), self.model.nv)) * noise)

    @torch.no_grad()
    def read(self, qpos: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Velocities at every moment of an episode, (T+1, nv)."""
        x = (self.around(qpos, actions) - self.mean) / self.std
        return (self.net(x) * self.out_std + self.out_mean).double().numpy()


def learn_velocities(
    task: Task, source: Domain, commands: Sequence[np.ndarray], noise: np.ndarray, seed: int
) -> VelocityReader:
    """A reader of velocities, from simulations of a source whose dynamics vary.

    Args:
        task: whose states tell positions.
        source: as it is now.
        commands: those of recordings, (T, nu) each.
        noise: standard deviation of a sensor's errors of positions, (nv,).
        seed: of everything.
    """
    motions = simulate(task, source, commands, np.random.default_rng(seed))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return VelocityReader(source.compile(), task.unseen).fit(motions, noise, seed)


def simulate(task: Task, source: Domain, commands: Sequence[np.ndarray], rng: np.random.Generator) -> list[Motion]:
    """Episodes that play the commands of recordings, each in a source that moves otherwise, until it is over."""
    motions, steps, model = [], 0, source.compile()
    while steps < STEPS:
        other = source.with_effects(*other_dynamics(model, rng))
        motions.append(play(task, other, commands[rng.integers(len(commands))], int(rng.integers(2**31))))
        steps += len(motions[-1].actions)
    return motions


def play(task: Task, domain: Domain, commands: np.ndarray, seed: int) -> Motion:
    """A sequence of commands, from where an episode of a domain begins until it is over."""
    with closing(VectorStateEnv(task, domain)) as env:
        obs, _ = env.reset(seed=seed)
        states = [obs["state"][0]]
        for action in commands:
            obs, _, terminations, truncations, infos = env.step(action[None])
            over = bool(terminations[0] or truncations[0])
            states.append((infos["final_obs"] if over else obs)["state"][0])
            if over:
                break
        qpos, qvel = task.motion(np.asarray(states, float), env.unwrapped.dt)
    return Motion(qpos, qvel, np.asarray(commands[: len(states) - 1], float))


def other_dynamics(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[Effect, ...]:
    """Motors, friction and a mass that differ from the source's by far more than what is to be found."""
    moved = np.unique(model.actuator_trnid[model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT), 0])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    typical = float(np.median(inertia.diagonal()[model.jnt_dofadr[moved]]))
    torque = float(np.median(np.abs(model.actuator_gear[:, 0] * model.actuator_ctrlrange[:, 1])))
    body = int(rng.choice(np.flatnonzero(model.body_mass > 0)))

    def times(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return (
        JointArmature(ACTUATED, typical * times(0.1, 3.0)),
        JointFrictionloss(ACTUATED, torque * 0.2 * float(rng.integers(2)) * rng.uniform()),
        ActuatorGain("*", times(0.4, 1.3)),
        BodyMass(model.body(body).name, float(model.body_mass[body]) * times(0.5, 3.0)),
    )
