"""Many simulations of one domain, whose states are guesses of one robot's."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.acting import has_laws
from idapt_pl.prediction.data import position_difference, shift_positions
from idapt_pl.tasks import Task


class SimulatedEnsemble:
    """n simulations that play the same actions.

    A guess is a vector (2 nv,): positions in the tangent space at :attr:`origin`, and velocities.

    Args:
        task: knows what an action is and what a state is.
        domain: whose physics they follow.
        n: how many.
        model: the domain's, if it is compiled already; it is read alone, so that threads can share it.
    """

    def __init__(self, task: Task, domain: Domain, n: int, model: mujoco.MjModel | None = None) -> None:
        self.task, self.domain = task, domain
        self.model = domain.compile() if model is None else model
        self.data = [mujoco.MjData(self.model) for _ in range(n)]
        self.origin = self.model.qpos0.copy()
        self._limits = self.model.actuator_ctrlrange.T.copy()

    def __len__(self) -> int:
        return len(self.data)

    def begin(self, states: np.ndarray) -> np.ndarray:
        """Forget what was, and begin with states (n, s). Returns the guesses (n, 2 nv)."""
        period = self.task.period(self.model)
        motions = [self.task.motion(state[None], period) for state in states]
        qpos, qvel = (np.concatenate(part) for part in zip(*motions, strict=True))
        for data in self.data:
            mujoco.mj_resetData(self.model, data)
        self.origin = qpos[0]
        return np.concatenate([position_difference(self.model, self.origin, qpos), qvel], 1)

    def put(self, guesses: np.ndarray) -> None:
        """Put the simulations into the states of guesses (n, 2 nv)."""
        nv = self.model.nv
        qpos = shift_positions(self.model, np.repeat(self.origin[None], len(guesses), 0), guesses[:, :nv])
        for data, q, v in zip(self.data, qpos, guesses[:, nv:], strict=True):
            data.qpos[:], data.qvel[:] = q, v

    def advance(self, action: np.ndarray) -> np.ndarray:
        """Play an action (nu,) for a control step. Returns the guesses (n, 2 nv); those that blew up are others'.

        If all blow up they stay where they were; readings then tell how far that is off.
        """
        played = self.domain.command(self.model, np.clip(action, *self._limits)[None])[0]
        before = self._motions()
        for data in self.data:
            for _ in range(self.task.action_repeat):
                self.task.play(self.model, data, played)
        qpos, qvel = self._motions()
        sound = np.isfinite(qpos).all(1) & np.isfinite(qvel).all(1)
        if not sound.any():
            for data in self.data:
                mujoco.mj_resetData(self.model, data)  # or what they remember of the last step stays NaN
            (qpos, qvel), sound = before, ~sound
        stand_in = np.flatnonzero(sound)[np.arange(len(sound)) % sound.sum()]
        rows = np.where(sound, np.arange(len(sound)), stand_in)
        qpos, qvel = qpos[rows], qvel[rows]
        self.origin = qpos[0]
        return np.concatenate([position_difference(self.model, self.origin, qpos), qvel], 1)

    def _motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Copies of all positions (n, nq) and velocities (n, nv)."""
        return np.array([d.qpos for d in self.data]), np.array([d.qvel for d in self.data])

    def states(self, guesses: np.ndarray) -> np.ndarray:
        """The states (n, s) that guesses (n, 2 nv) are."""
        self.put(guesses)
        for data in self.data:
            mujoco.mj_kinematics(self.model, data)
        return np.array([self.task.state(self.model, data) for data in self.data])


def with_longer_steps(task: Task, model: mujoco.MjModel) -> tuple[Task, mujoco.MjModel]:
    """Task and model with half as many physics steps, each twice as long, where the model's integrator is RK4.

    Its errors are of the fourth order: in flight and on firm feet they stay far below what guesses are moved by at
    random in each control step (docs/decisions/086). Other models, and those with force laws, stay as they are.
    """
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4 or task.frame_skip % 2 or has_laws(model):
        return task, model
    quick, longer = copy.copy(task), copy.copy(model)
    quick.frame_skip //= 2
    longer.opt.timestep *= 2
    return quick, longer
