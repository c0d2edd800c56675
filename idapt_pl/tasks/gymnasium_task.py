"""A Gymnasium environment on MuJoCo as a task: ``gymnasium:Reacher-v5``."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium
import mujoco
import numpy as np

from idapt_pl.effects.visual import CAMERA, CameraPose
from idapt_pl.tasks.environment_task import WITHOUT_LIMIT, EnvironmentTask, changed_by, check_actuated, options_of
from idapt_pl.tasks.told_motion import flat_state

USUAL_CAMERA = "track"
"""The camera that Gymnasium looks through if there is one."""


class GymnasiumTask(EnvironmentTask):
    """Model, start, state (its observation), reward and end are the environment's.

    Each simulation has a copy of the environment, for what it remembers within an episode. The copy is lent the
    simulation's model and data, so that the environment's own code works on any domain.

    Args:
        env_id: as of :func:`gymnasium.make`; ``module:id`` imports the module first.
        options: of :class:`EnvironmentTask`; all others go to :func:`gymnasium.make`.

    Raises:
        ValueError: if there is no such environment, or it is not one of MuJoCo's whose actions are its actuators'.
    """

    def __init__(self, env_id: str, **options: Any) -> None:
        name, own = f"gymnasium:{env_id}", options_of(options)
        try:
            made = gymnasium.make(env_id, **options)
        except (gymnasium.error.Error, TypeError, ImportError) as error:
            raise ValueError(f"task {name}: gymnasium.make says: {error}") from error
        env: Any = made.unwrapped
        if not isinstance(getattr(env, "model", None), mujoco.MjModel) or not hasattr(env, "reset_model"):
            raise ValueError(
                f"task {name} is not one of Gymnasium's MuJoCo environments ({type(env).__name__}), so no model "
                "can be repaired. As a target it will do: target: {env: ...}"
            )
        self._env, self._file = env, Path(env.fullpath)
        self._copies: WeakKeyDictionary[mujoco.MjData, Any] = WeakKeyDictionary()
        self._outcomes: WeakKeyDictionary[mujoco.MjData, tuple[float, bool]] = WeakKeyDictionary()
        limit = made.spec.max_episode_steps if made.spec and made.spec.max_episode_steps else WITHOUT_LIMIT
        super().__init__(name, env.frame_skip, limit, **own)
        check_actuated(name, env.action_space.low, env.action_space.high, env.model)
        if changed := changed_by(self.load().compile(), env.model):
            raise ValueError(
                f"{name} changes its model after it has read {self._file}: {', '.join(changed)}. A domain begins with "
                "the file. Write a task of your own that makes these changes in `base`"
            )
        self.look_into_states()

    def load(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_file(str(self._file))

    def usual_camera(self, names: list[str]) -> str | None:
        return USUAL_CAMERA if USUAL_CAMERA in names else None

    def free_camera(self, model: mujoco.MjModel) -> CameraPose:
        """Gymnasium's: at what is in the middle of all geoms, from as far as the model is wide, unless it says more."""
        data, view = mujoco.MjData(model), mujoco.MjvCamera()
        mujoco.mj_forward(model, data)
        mujoco.mjv_defaultFreeCamera(model, view)
        says = {"lookat": np.median(data.geom_xpos, 0), "distance": model.stat.extent, "azimuth": view.azimuth}
        says |= {"elevation": view.elevation} | (self._env.mujoco_renderer.default_cam_config or {})
        x, y, z = map(float, says["lookat"])
        azimuth, elevation, distance = (float(says[part]) for part in ("azimuth", "elevation", "distance"))
        return CameraPose(CAMERA, azimuth, elevation, distance, (x, y, z))

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        with self._lent(model, data) as env:
            env.np_random = rng
            env.reset_model()

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        with self._lent(model, data) as env:
            return flat_state(env._get_obs())

    def play(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> None:
        with self._lent(model, data) as env:
            _, reward, over, _, _ = env.step(np.asarray(action))
        self._outcomes[data] = float(reward), bool(over)

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        return self._outcomes[data]

    @contextmanager
    def _lent(self, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Any]:
        """The simulation's copy of the environment, for as long as it may have model and data."""
        env = self._copies.get(data)
        if env is None:
            env = self._copies[data] = copy.copy(self._env)
        env.model, env.data = model, data
        try:
            yield env
        finally:
            env.model = env.data = None  # what remembers the data would keep them for ever
