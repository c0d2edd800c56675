"""Tasks that are not this project's: from environments of others, and from the user's own modules."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import gymnasium

from datamodules.users_error import UsersError
from idapt_pl.tasks.own_check import check_task
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.users_code import whole

SOURCES = "gymnasium:ID, dm_control:DOMAIN/TASK, or MODULE:NAME for a Task of your own"
"""What a task's name can be besides the names there are."""


def own_task(name: str, options: dict[str, Any]) -> Task:
    """A task by a name with a colon in it.

    Args:
        name: one of :data:`SOURCES`.
        options: of its constructor.

    Raises:
        UsersError: if the user's own module fails, whose error is shown whole.
        ValueError: if it cannot be made.
    """
    source, _, rest = name.partition(":")
    look_here_too()
    if source == "gymnasium":
        from idapt_pl.tasks.gymnasium_task import GymnasiumTask

        return GymnasiumTask(rest, **options)
    if source == "dm_control":
        from idapt_pl.tasks.dm_control_task import DMControlTask  # 2 s to import

        return DMControlTask(rest, **options)
    made, repeat = import_from(name, "task"), options.get("action_repeat")
    own = {k: v for k, v in options.items() if k != "action_repeat"}  # which every task has
    task = call_users(made, f"task {name}", own) if callable(made) else made
    if not isinstance(task, Task):
        if isinstance(task, gymnasium.Env):
            raise ValueError(
                f"task {name} is an environment of Gymnasium. Register it there (gymnasium.register), and give "
                f"gymnasium:{name.partition(':')[0]}:ID"
            )
        raise ValueError(
            f"task {name} is {type(task).__name__}, not an idapt_pl.tasks.Task. Give a subclass of it, or a function "
            "that returns one (docs/guide/own_robot.md)"
        )
    if not hasattr(task, "name"):
        task.name = name
    if repeat is not None:
        task.action_repeat = repeat
    check_task(name, task)
    return task


def look_here_too() -> None:
    """Let modules be found in the current folder, as `python -m` does."""
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())


def import_from(path: str, what: str) -> Any:
    """What ``module:name`` names; modules are looked for in the current folder too.

    Args:
        path: ``module:name``.
        what: it is to be, for messages.

    Raises:
        UsersError: if the module fails, whose error is shown whole.
        ValueError: if there is no such thing.
    """
    module_name, _, attribute = path.partition(":")
    if not module_name or not attribute:
        raise ValueError(f"{what} {path!r} is no import path; give MODULE:NAME, such as my_robot.task:Reach")
    look_here_too()
    try:
        found = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not (module_name + ".").startswith(error.name + "."):
            raise UsersError(whole(f"{what} {path}: its module fails")) from None
        raise ValueError(
            f"{what} {path}: there is no module {error.name!r} in {os.getcwd()} or among the installed packages"
        ) from None
    except Exception:
        raise UsersError(whole(f"{what} {path}: its module fails")) from None
    for part in attribute.split("."):
        if not hasattr(found, part):
            names = [name for name in vars(found) if not name.startswith("_")]
            raise ValueError(f"{what} {path}: {found.__name__} has no {part!r}; it has: {', '.join(names)}")
        found = getattr(found, part)
    return found


def call_users(made: Any, what: str, options: dict[str, Any]) -> Any:
    """What a user's class or function gives.

    Raises:
        UsersError: if it fails; its error is shown whole.
        ValueError: if it is this package's, such as the client of a robot's server; its message says enough.
    """
    try:
        return made(**options)
    except Exception as error:
        if str(getattr(made, "__module__", "")).startswith("idapt_pl."):
            raise ValueError(f"{what}: {error}") from error
        raise UsersError(whole(f"{what} fails")) from None
