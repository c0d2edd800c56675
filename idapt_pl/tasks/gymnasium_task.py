"""A Gymnasium environment on MuJoCo as a task: ``gymnasium:Reacher-v5``."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium
import mujoco
import numpy as np

from datamodules.users_error import UsersError
from idapt_pl.effects.visual import CAMERA, CameraPose
from idapt_pl.tasks.environment_task import (
    WITHOUT_LIMIT,
    EnvironmentTask,
    changed_by,
    check_actuated,
    check_one_model,
    options_of,
)
from idapt_pl.tasks.told_motion import flat_state
from idapt_pl.tasks.users_code import whole

USUAL_CAMERA = "track"
"""The camera that Gymnasium looks through if there is one."""


@dataclass(frozen=True)
class ActionScale:
    """How an environment that scales its actions makes commands of them: its bounds are the ends of actuators' ranges.

    Attributes:
        low: lower bounds of its actions, (nu,).
        high: upper bounds.
        ranges: of the actuators, (nu, 2).
    """

    low: np.ndarray
    high: np.ndarray
    ranges: np.ndarray

    @classmethod
    def of(cls, env: Any) -> ActionScale | None:
        """The scale of an environment; None where actions are commands already, or become commands in other ways."""
        low, high, ranges = env.action_space.low, env.action_space.high, env.model.actuator_ctrlrange.copy()
        scale = cls(low.astype(float), high.astype(float), ranges)
        if len(low) != len(ranges) or not env.model.actuator_ctrllimited.all() or not np.isfinite([low, high]).all():
            return None
        if np.allclose(low, ranges[:, 0]) and np.allclose(high, ranges[:, 1]):
            return None
        rng = np.random.default_rng(0)
        for _ in range(PROBES):  # whatever it was before
            env.reset(seed=0)
            commands = rng.uniform(ranges[:, 0], ranges[:, 1])
            env.step(scale.to_environment(commands))
            if not np.allclose(env.data.ctrl, commands, atol=1e-5 * np.ptp(ranges, axis=1).max()):
                return None
        return scale

    def to_environment(self, commands: np.ndarray) -> np.ndarray:
        """Actions of the environment for commands (nu,) of the actuators."""
        share = (np.asarray(commands) - self.ranges[:, 0]) / np.ptp(self.ranges, axis=1)
        return (self.low + share * (self.high - self.low)).astype(np.float32)


PROBES = 3
"""Random commands by which an environment shows how it scales its actions."""


class GymnasiumTask(EnvironmentTask):
    """Model, start, state (its observation), reward and end are the environment's.

    Each simulation has a copy of the environment, for what it remembers within an episode. The copy is lent the
    simulation's model and data, so that the environment's own code works on any domain.

    Args:
        env_id: as of :func:`gymnasium.make`; ``module:id`` imports the module first.
        options: of :class:`EnvironmentTask`; all others go to :func:`gymnasium.make`.

    Raises:
        ValueError: if there is no such environment, it is not one of MuJoCo's whose actions are its actuators', or it
            changes its model.
        UsersError: if its own code fails.
    """

    def __init__(self, env_id: str, **options: Any) -> None:
        name, own = f"gymnasium:{env_id}", options_of(options)
        try:
            made = gymnasium.make(env_id, **options)
        except (gymnasium.error.Error, TypeError, ImportError) as error:
            raise ValueError(f"task {name}: gymnasium.make says: {error}") from error
        except Exception:  # packages of environments that do not go with this MuJoCo fail in many ways
            raise UsersError(whole(f"task {name}: the environment fails with MuJoCo {mujoco.__version__}")) from None
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
        nominal = self.load().compile()
        if changed := changed_by(nominal, env.model):
            raise ValueError(
                f"{name} changes its model after it has read {self._file}: {', '.join(changed)}. A domain begins with "
                "the file. Write a task of your own that makes these changes in `base`"
            )
        try:
            self._scale = ActionScale.of(env)
            for _ in range(2):
                env.reset()
        except Exception:
            raise UsersError(whole(f"task {name}: the environment fails where it is tried")) from None
        if self._scale is None:
            check_actuated(name, env.action_space.low, env.action_space.high, env.model)
        check_one_model(name, nominal, env.model)
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
            own = np.asarray(action) if self._scale is None else self._scale.to_environment(action)
            _, reward, over, _, _ = env.step(own)
        self._outcomes[data] = float(reward), bool(over)

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        return self._outcomes[data]

    @contextmanager
    def _lent(self, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Any]:
        """The simulation's copy of the environment, for as long as it may have model and data."""
        env = self._copies.get(data)
        if env is None:
            env = self._copies[data] = twin_of(self._env)
        env.model, env.data = model, data
        try:
            yield env
        finally:
            env.model = env.data = None  # what remembers the data would keep them for ever


LENT = ("model", "data", "mujoco_renderer")
"""What a copy of an environment does not need of its own."""


def twin_of(env: Any) -> Any:
    """An environment with a memory of its own, made by none of its code: copying Gymnasium's would make them anew."""
    twin = object.__new__(type(env))
    for name, value in vars(env).items():
        try:
            twin.__dict__[name] = value if name in LENT else copy.deepcopy(value)
        except Exception:  # what cannot be copied is shared, as a viewer is
            twin.__dict__[name] = value
    return twin
