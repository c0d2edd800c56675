"""What a task is: a base model, a start, a state vector, a reward and an end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.acting import advance
from idapt_pl.tasks.recipe import ExpertRecipe


class Task(ABC):
    """A control task, the same in every domain; stateless, so one instance serves many simulations.

    Attributes:
        name: as on the command line.
        frame_skip: physics steps that an action is held for, before a reward is given.
        action_repeat: how often that is repeated in a control step; rewards are summed.
        horizon: control steps after which an episode is cut (a time limit, not an end of the task).
        rates: state component to the component it is the rate of change of.
        unseen: joints whose positions no state tells, as nothing depends on them.
        metric: what `evaluate` reports, ``"return"`` or ``"success"``.
        expert: how a policy on true states is trained, for datasets, as a teacher and as a bound.
    """

    name: str
    frame_skip: int
    action_repeat: int = 1
    horizon: int
    metric: str = "return"
    expert: ExpertRecipe = ExpertRecipe(steps=50_000)
    rates: Mapping[int, int] = MappingProxyType({})
    unseen: tuple[str, ...] = ()

    @abstractmethod
    def base(self) -> mujoco.MjSpec:
        """The base model, with a camera named ``"view"``."""

    @abstractmethod
    def domains(self) -> dict[str, Domain]:
        """The domains ``source``, ``easy`` and ``hard``."""

    @abstractmethod
    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Draw a start state into ``data.qpos``, ``data.qvel``, which hold the model's defaults."""

    @abstractmethod
    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """The state vector s, float64 (state_dim,); what critics see and predictors predict."""

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions (T+1, nq) and velocities (T+1, nv) along a sequence of states (T+1, state_dim), ``period`` s apart.

        What states leave out (``unseen``) is integrated from its rate, from 0.

        Raises:
            ValueError: where states do not tell.
        """
        raise ValueError(
            f"labels.members needs positions, which the states of {self.name} do not tell. Set labels.members: 0."
        )

    @property
    def tells_positions(self) -> bool:
        """Whether :meth:`motion` knows positions of states."""
        return type(self).motion is not Task.motion

    @abstractmethod
    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        """Reward and termination after ``frame_skip`` physics steps with ``action`` (nu,)."""

    def play(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> None:
        """Hold an action (nu,), within the actuators' ranges, for ``frame_skip`` physics steps."""
        data.ctrl[:] = action
        advance(model, data, self.frame_skip)

    def step(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        """Play one control step with an action (nu,). Returns its reward and whether the task is over."""
        total, over = 0.0, False
        for _ in range(self.action_repeat):
            self.play(model, data, action)
            reward, over = self.outcome(model, data, action)
            total += reward
            if over:
                break
        return total, over

    def success(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Whether the goal is reached.

        Raises:
            NotImplementedError: of tasks whose metric is not success.
        """
        raise NotImplementedError

    def period(self, model: mujoco.MjModel) -> float:
        """Control period, s."""
        return model.opt.timestep * self.frame_skip * self.action_repeat

    def backwards(self) -> Task:
        """The same task paid for going the other way; its policies give task-agnostic data (Section V).

        Raises:
            ValueError: if the task has no direction.
        """
        raise ValueError(f"task {self.name!r} has no direction, so there is no policy 'backwards' for it")

    def domain(self, name: str) -> Domain:
        """One domain by name.

        Raises:
            ValueError: if there is none; the message lists the names there are.
        """
        domains = self.domains()
        if name not in domains:
            cure = f". For an environment of your own give target: {{env: {name!r}}}" if ":" in name else ""
            raise ValueError(f"task {self.name!r} has no domain {name!r}; it has: {', '.join(domains)}{cure}")
        return domains[name]
