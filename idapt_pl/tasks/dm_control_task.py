"""A task of dm_control's suite: ``dm_control:cartpole/swingup``."""

from __future__ import annotations

import copy
import threading
from collections import OrderedDict
from typing import Any
from unittest import mock

import mujoco
import numpy as np
from dm_control import suite
from dm_control.mujoco import Physics
from dm_control.mujoco.wrapper import MjModel

from idapt_pl.tasks.environment_task import WITHOUT_LIMIT, EnvironmentTask, check_actuated, check_one_model, options_of
from idapt_pl.tasks.told_motion import flat_state

KEPT_MODELS = 8
"""For which a thread has dm_control's view of the physics at hand."""


class DMControlTask(EnvironmentTask):
    """Model, start, state (its observation), reward and end are the suite's.

    dm_control's own code looks at a simulation through a ``Physics``, into which the simulation is copied. There is
    one for each thread and model.

    Args:
        task: ``domain/task``.
        options: of :class:`EnvironmentTask`; all others go to the suite's function.

    Raises:
        ValueError: if there is no such task, or it changes its model where an episode begins.
    """

    def __init__(self, task: str, **options: Any) -> None:
        name, own = f"dm_control:{task}", options_of(options)
        env, self._xml, self._assets = load_from_suite(name, task, options)
        self._task, self._physics_type = env.task, type(env.physics)
        self._mine = threading.local()
        limit = int(env._step_limit) if np.isfinite(env._step_limit) else WITHOUT_LIMIT
        super().__init__(name, env._n_sub_steps, limit, **own)
        model, spec = env.physics.model.ptr, env.action_spec()
        check_actuated(name, spec.minimum, spec.maximum, model)
        nominal = self.load().compile()
        for _ in range(2):
            env.reset()
        check_one_model(name, nominal, model)
        self.look_into_states()

    def load(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(self._xml, include=dict(self._assets), assets=dict(self._assets))

    def usual_camera(self, names: list[str]) -> str | None:
        return names[0] if names else None  # the suite renders its first

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        task, physics = self._looking_at(model, data)
        task._random = np.random.RandomState(rng.integers(2**31))
        with physics.reset_context():
            task.initialize_episode(physics)
        mujoco.mj_copyData(data, model, physics.data.ptr)

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        task, physics = self._looking_at(model, data)
        return flat_state(task.get_observation(physics))

    def play(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> None:
        super().play(model, data, action)
        mujoco.mj_step1(model, data)  # the suite looks at positions as they are after the last step

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        task, physics = self._looking_at(model, data)
        task.after_step(physics)
        return float(task.get_reward(physics)), task.get_termination(physics) is not None

    def _looking_at(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Any, Any]:
        """The suite's task and its physics, this thread's own, with a copy of a simulation in it."""
        if not hasattr(self._mine, "physics"):
            self._mine.task, self._mine.physics = copy.copy(self._task), OrderedDict()
        known: OrderedDict[int, Any] = self._mine.physics
        if id(model) not in known:  # whose physics keeps it, so no other model can have its id
            known[id(model)] = self._physics_type.from_model(MjModel(model))
            while len(known) > KEPT_MODELS:
                known.popitem(last=False)
        physics = known[id(model)]
        mujoco.mj_copyData(physics.data.ptr, model, data)
        return self._mine.task, physics


def load_from_suite(name: str, task: str, options: dict[str, Any]) -> tuple[Any, str, dict[str, bytes]]:
    """An environment of the suite, its MJCF, and the files that this includes.

    The suite makes MJCF in Python and has it no more once it is loaded; it is taken where MuJoCo gets it.

    Raises:
        ValueError: if there is no such task.
    """
    domain, _, task_name = task.partition("/")
    if (domain, task_name) not in suite.ALL_TASKS:
        similar = [f"{d}/{t}" for d, t in suite.ALL_TASKS if d == domain] or sorted({d for d, _ in suite.ALL_TASKS})
        raise ValueError(f"unknown task {name!r}; dm_control's suite has: {', '.join(similar)}")
    seen: list[tuple[Any, Any]] = []
    read = Physics.from_xml_string.__func__

    def reading(cls: type, xml_string: Any, assets: Any = None) -> Any:
        seen.append((xml_string, assets))
        return read(cls, xml_string, assets)

    with mock.patch.object(Physics, "from_xml_string", classmethod(reading)):
        try:
            env = suite.load(domain, task_name, task_kwargs=options | {"random": 0})
        except TypeError as error:
            raise ValueError(f"task {name}: {error}") from error
    xml, assets = seen[-1]
    files = {file: content if isinstance(content, bytes) else content.encode() for file, content in assets.items()}
    return env, xml.decode() if isinstance(xml, bytes) else xml, files
