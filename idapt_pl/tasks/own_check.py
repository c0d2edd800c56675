"""Whether a task of the user's own can be played: seen before a robot moves, and before hours of training."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

from datamodules.users_error import UsersError
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.users_code import whole

SOURCE_CAMERA = "view"
"""Through which source images are seen."""


def check_task(name: str, task: Task) -> None:
    """Compile a task's source, begin an episode and take a step.

    Raises:
        UsersError: if a method of it fails; the error is shown whole.
        ValueError: if something is missing, or no number; the message says what and what was expected.
    """

    def ask(method: str, *args: Any) -> Any:
        return asked(name, method, getattr(task, method), *args)

    for attribute in ("frame_skip", "action_repeat", "horizon"):
        value = getattr(task, attribute, None)
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"task {name}: {attribute} is {value!r}; expected a whole number, at least 1")
    base, domains = ask("base"), ask("domains")
    if not isinstance(base, mujoco.MjSpec):
        raise ValueError(
            f"task {name}: base() gives {type(base).__name__}, expected a mujoco.MjSpec, such as "
            'mujoco.MjSpec.from_file("robot.xml")'
        )
    if not isinstance(domains, Mapping) or "source" not in domains:
        raise ValueError(f'task {name}: domains() gives {type(domains).__name__}; expected {{"source": Domain(...)}}')
    model = asked(name, "the model of domains()", domains["source"].compile)
    check_model(name, model)
    data = mujoco.MjData(model)
    ask("reset", model, data, np.random.default_rng(0))
    mujoco.mj_forward(model, data)
    check_state(name, "after a reset", ask("state", model, data))
    action = model.actuator_ctrlrange.mean(1)
    ask("play", model, data, action)
    check_outcome(name, ask("outcome", model, data, action))
    check_state(name, "after a step", ask("state", model, data))


def asked(name: str, what: str, function: Callable[..., Any], *args: Any) -> Any:
    """What a function of the user's gives.

    Raises:
        UsersError: if it fails.
    """
    try:
        return function(*args)
    except Exception:
        raise UsersError(whole(f"task {name}: {what} fails")) from None


def check_model(name: str, model: mujoco.MjModel) -> None:
    """A camera to look through, and actuators whose commands have bounds.

    Raises:
        ValueError: if there are none.
    """
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if SOURCE_CAMERA not in cameras:
        raise ValueError(
            f"task {name}: its model has no camera {SOURCE_CAMERA!r}, through which it is seen; it has: "
            f'{", ".join(cameras) or "none"}. Name one so, as in <camera name="{SOURCE_CAMERA}" pos="0 -2 1" .../>'
        )
    if not model.nu:
        raise ValueError(f"task {name}: its model has no actuators; nothing would move")
    if not model.actuator_ctrllimited.all():
        free = [model.actuator(i).name or str(i) for i in np.flatnonzero(model.actuator_ctrllimited == 0)]
        raise ValueError(
            f"task {name}: actuators without a ctrlrange: {', '.join(free)}. Actions are as far as that allows; give "
            'each one, as in <motor ctrlrange="-1 1" .../>'
        )


def check_state(name: str, when: str, state: Any) -> None:
    """A state is a vector of finite numbers.

    Raises:
        ValueError: if it is not.
    """
    vector = asked(name, "state", lambda: np.asarray(state, float))
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise ValueError(f"task {name}: state() {when} is {vector}; expected finite numbers in one row")


def check_outcome(name: str, outcome: Any) -> None:
    """An outcome is a reward and whether the task is over.

    Raises:
        ValueError: if it is not.
    """
    if not isinstance(outcome, tuple) or len(outcome) != 2:
        raise ValueError(f"task {name}: outcome() gives {outcome!r}; expected (reward, over), as (1.0, False)")
    reward, over = outcome
    if np.ndim(reward) or not np.isfinite(reward):
        raise ValueError(f"task {name}: outcome()'s reward is {reward!r}; expected a finite number, float(...)")
    if not isinstance(over, bool | np.bool_):
        raise ValueError(f"task {name}: outcome()'s second value is {over!r}; expected True or False")
