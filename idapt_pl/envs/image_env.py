"""A task in a domain as a vectorised Gymnasium environment with image observations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias, cast

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.rendering.parallel import BatchRenderer, ParallelRenderer
from idapt_pl.rendering.several import RendererOfSeveral
from idapt_pl.tasks import Task

Observations: TypeAlias = dict[str, np.ndarray]
"""Name to array, a row for each simulation."""
ResetResult: TypeAlias = tuple[Observations, dict[str, Any]]
"""What ``reset`` returns: observations and infos."""
StepResult: TypeAlias = tuple[Observations, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""What ``step`` returns: observations, rewards float (n,), terminations and truncations bool (n,), and infos."""


_PARTS = ("QPOS", "QVEL", "MOCAP_POS", "MOCAP_QUAT")
SHOWN = sum(int(getattr(mujoco.mjtState, f"mjSTATE_{part}")) for part in _PARTS)
"""The parts of MuJoCo's state that images and state vectors show."""


class VectorImageEnv(gymnasium.vector.VectorEnv):
    """``num_envs`` simulations of one domain, stepped together and seen by one renderer.

    Observations: ``pixels`` uint8 (n, K, H, W, 3), the last K frames, oldest first; ``state`` float32
    (n, state_dim); with ``whole`` also ``simulation`` float64 (n, size), which :meth:`restore` takes. Actions: float32
    (n, nu) in the actuators' units, clipped to ``ctrlrange``.
    A finished simulation is reset in the same step; its last observation is ``infos["final_obs"]``. Where the task's
    metric is success, ``infos["success"]`` is bool (n,), as of before that reset.

    Args:
        task: the task.
        domain: the world it is played in.
        num_envs: number of simulations.
        image_size: height and width of a frame, pixels.
        frame_stack: K.
        view: the part of the camera's image that is rendered.
        render_processes: further processes that render, where there are several simulations (``ParallelRenderer``).
        variants: worlds that episodes begin in, in place of ``domain`` (domain randomisation): shuffled, and each once
            before any comes again.
        horizon: control steps after which episodes are cut; 0 is the task's.
        whole: whether observations have the whole simulation, too.
    """

    single_action_space: gymnasium.spaces.Box
    single_observation_space: gymnasium.spaces.Dict
    observation_space: gymnasium.spaces.Dict

    def __init__(
        self,
        task: Task,
        domain: Domain,
        num_envs: int = 1,
        image_size: int = 64,
        frame_stack: int = 3,
        view: View = WHOLE,
        render_processes: int = 0,
        variants: Sequence[Domain] = (),
        horizon: int = 0,
        whole: bool = False,
    ) -> None:
        self.whole = whole
        self.horizon = horizon or task.horizon
        self.task, self.domain, self.num_envs = task, domain, num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.model = domain.compile(view)
        self.variants = tuple(variants) or (domain,)
        self._compiled = [v.compile(view) for v in variants] or [self.model]
        check_alike(self.model, self._compiled)
        self._drawn = np.zeros(num_envs, int)
        self._variant_rng, self._to_come = np.random.default_rng(), list[int]()
        self.data = [mujoco.MjData(self._compiled[0]) for _ in range(num_envs)]
        self._render = self._make_renderer(image_size, render_processes)
        self._rng = np.random.default_rng()
        self._elapsed = np.zeros(num_envs, dtype=int)
        self._frames = np.zeros((num_envs, frame_stack, image_size, image_size, 3), np.uint8)

        self._limits = low, high = self.model.actuator_ctrlrange.T.astype(np.float32)
        self.single_action_space = gymnasium.spaces.Box(low, high)
        self.state_dim = len(task.state(self.model, self.data[0]))
        self.single_observation_space = gymnasium.spaces.Dict(
            {
                "pixels": gymnasium.spaces.Box(0, 255, self._frames.shape[1:], np.uint8),
                "state": gymnasium.spaces.Box(-np.inf, np.inf, (self.state_dim,), np.float32),
            }
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = cast(gymnasium.spaces.Dict, batch_space(self.single_observation_space, num_envs))

    @property
    def dt(self) -> float:
        """Control period, s."""
        return self.task.period(self.model)

    @property
    def models(self) -> list[mujoco.MjModel]:
        """The model that each simulation is in now."""
        return [self._compiled[v] for v in self._drawn]

    def states(self) -> np.ndarray:
        """The state vectors, float32 (n, state_dim)."""
        states = [self.task.state(m, data) for m, data in zip(self.models, self.data, strict=True)]
        return np.asarray(states, np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin new episodes; with ``options={"reset_mask": mask}`` in the simulations that it marks only."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
            self._variant_rng = np.random.default_rng([seed, len(self.variants)])  # starts are drawn as without any
            self._to_come = []
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, bool))
        self._reset(np.flatnonzero(mask))
        return self._observe(), {}

    def step(self, actions: np.ndarray) -> StepResult:
        actions = np.clip(actions, *self._limits)
        actions, models = self._commanded(actions), self.models
        rewards = np.zeros(self.num_envs)
        terminations = np.zeros(self.num_envs, bool)
        for i, data in enumerate(self.data):
            rewards[i], terminations[i] = self.task.step(models[i], data, actions[i])
        self._look()
        self._elapsed += 1
        truncations = (self._elapsed >= self.horizon) & ~terminations
        done = terminations | truncations
        infos: dict[str, Any] = {}
        if self.task.metric == "success":
            infos["success"] = np.array([self.task.success(m, d) for m, d in zip(models, self.data, strict=True)])
        if done.any():
            infos |= {"final_obs": self._observe(), "_final_obs": done}
            self._reset(np.flatnonzero(done))
        return self._observe(), rewards, terminations, truncations, infos

    def show(self, i: int, other: mujoco.MjData) -> np.ndarray:
        """Put simulation ``i`` into the state of another domain's. Returns its frame, uint8 (H, W, 3).

        For paired evaluation only.
        """
        self.data[i].mocap_pos[:], self.data[i].mocap_quat[:] = other.mocap_pos, other.mocap_quat
        return self.set_state(i, other.qpos, other.qvel)

    def set_state(self, i: int, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Put simulation ``i`` into a state (positions (nq,), velocities (nv,)). Returns its frame, uint8 (H, W, 3).

        For paired evaluation, and for images of poses that no motion brings about.
        """
        self.data[i].qpos[:], self.data[i].qvel[:] = qpos, qvel
        mujoco.mj_forward(self.models[i], self.data[i])
        self._frames[i, -1] = self._render([self.data[i]])[0]
        return self._frames[i, -1].copy()

    def restore(self, i: int, simulation: np.ndarray) -> mujoco.MjData:
        """Put simulation ``i`` where an observed one was, (size,). Returns it, to be moved and shown."""
        mujoco.mj_setState(self.models[i], self.data[i], simulation, SHOWN)
        return self.data[i]

    def close_extras(self, **kwargs: Any) -> None:
        self._render.close()

    def _reset(self, which: np.ndarray) -> None:
        """Begin new episodes. The first frame of an episode fills the whole stack."""
        for i in which:
            model = self._draw_variant(i)
            mujoco.mj_resetData(model, self.data[i])
            self.task.reset(model, self.data[i], self._rng)
            mujoco.mj_forward(model, self.data[i])
        self._elapsed[which] = 0
        self._frames[which] = self._render([self.data[i] for i in which])[:, None]

    def _draw_variant(self, i: int) -> mujoco.MjModel:
        """Put simulation ``i`` into the next variant. Returns its model."""
        if len(self.variants) > 1:
            if not self._to_come:
                self._to_come = self._variant_rng.permutation(len(self.variants)).tolist()
            self._drawn[i] = self._to_come.pop()
            self.data[i] = mujoco.MjData(self._compiled[self._drawn[i]])
        return self._compiled[self._drawn[i]]

    def _commanded(self, actions: np.ndarray) -> np.ndarray:
        """What effects that MJCF has no words for make of actions (n, nu)."""
        commands = np.empty_like(actions)
        for v in np.unique(self._drawn):
            chosen = self._drawn == v
            commands[chosen] = self.variants[v].command(self._compiled[v], actions[chosen])
        return commands

    def _make_renderer(self, size: int, processes: int) -> BatchRenderer:
        if len(self._compiled) == 1:
            return ParallelRenderer(self._compiled[0], size, processes)
        return RendererOfSeveral(self._compiled, size)

    def _look(self) -> None:
        """Take the newest frames."""
        self._frames[:, :-1] = self._frames[:, 1:]
        self._frames[:, -1] = self._render(self.data)

    def _observe(self) -> Observations:
        shown = {"pixels": self._frames.copy(), "state": self.states()}
        return shown | {"simulation": self._simulations()} if self.whole else shown

    def _simulations(self) -> np.ndarray:
        """What is shown and moves, by simulation: float64 (n, size)."""
        kept = np.empty((self.num_envs, mujoco.mj_stateSize(self.model, SHOWN)))
        for row, model, data in zip(kept, self.models, self.data, strict=True):
            mujoco.mj_getState(model, data, row, SHOWN)
        return kept


def check_alike(model: mujoco.MjModel, variants: Sequence[mujoco.MjModel]) -> None:
    """Whether variants have the state and the commands of a model.

    Raises:
        ValueError: if they do not.
    """
    for variant in variants:
        for size in ("nq", "nv", "nu"):
            if getattr(variant, size) != getattr(model, size):
                raise ValueError(
                    f"a variant of the source has {size} {getattr(variant, size)}, the source {getattr(model, size)}: "
                    "randomisation may not add or take away joints or actuators"
                )
