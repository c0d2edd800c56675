"""Tasks that are not this project's: from environments of others, and from the user's own modules."""

from __future__ import annotations

from typing import Any

import gymnasium

from idapt_pl.tasks.named import import_from, look_here_too, make_named, refuse_pythons_own
from idapt_pl.tasks.own_check import check_task
from idapt_pl.tasks.task import Task

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
    if source == "gymnasium":
        from idapt_pl.tasks.gymnasium_task import GymnasiumTask

        look_for_ids(rest, f"task {name}")
        return GymnasiumTask(rest, **options)
    if source == "dm_control":
        from idapt_pl.tasks.dm_control_task import DMControlTask  # 2 s to import

        return DMControlTask(rest, **options)
    refuse_environment(name)
    repeat = options.get("action_repeat")
    own = {k: v for k, v in options.items() if k != "action_repeat"}  # which every task has
    task = make_named(name, Task, "task", own)
    if not isinstance(task, Task):
        raise ValueError(
            f"task {name} gives {type(task).__name__}, not an idapt_pl.tasks.Task (docs/guide/own_robot.md)"
        )
    if not hasattr(task, "name"):
        task.name = name
    if repeat is not None:
        task.action_repeat = repeat
    check_task(name, task)
    return task


def look_for_ids(env_id: str, what: str) -> None:
    """Let Gymnasium find the module of ``module:id`` in the current folder.

    Raises:
        ValueError: if it is one of Python's own, which Gymnasium would import.
    """
    module, colon, _ = env_id.partition(":")
    if colon:
        refuse_pythons_own(module, what)
    look_here_too()


def refuse_environment(name: str) -> None:
    """Say what to do where a class of Gymnasium's environments is named as a task.

    Raises:
        ValueError: if it is one.
    """
    found = import_from(name, "task")
    if isinstance(found, gymnasium.Env) or (isinstance(found, type) and issubclass(found, gymnasium.Env)):
        raise ValueError(
            f"task {name} is an environment of Gymnasium. Register it there (gymnasium.register), and give "
            f"gymnasium:{name.partition(':')[0]}:ID"
        )
