"""The tasks, by the names the command line uses."""

from collections.abc import Mapping
from typing import Any

from idapt_pl.tasks.fetch_reach import FetchReach
from idapt_pl.tasks.half_cheetah import HalfCheetah
from idapt_pl.tasks.inverted_pendulum import InvertedPendulum
from idapt_pl.tasks.model_file import robot_spec
from idapt_pl.tasks.own import SOURCES, own_task
from idapt_pl.tasks.sawyer_push import SawyerPush
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.walker2d import Walker2d

_ALL = (InvertedPendulum, HalfCheetah, Walker2d, FetchReach, SawyerPush)
TASKS: dict[str, type[Task]] = {task.name: task for task in _ALL}


def make_task(name: str, options: Mapping[str, Any] | None = None) -> Task:
    """A task by name.

    Args:
        name: one of :data:`TASKS`, or one of :data:`SOURCES`.
        options: of the constructor of one that is not ours.

    Raises:
        ValueError: if there is none; the message lists the names there are.
    """
    if ":" in name:
        return own_task(name, dict(options or {}))
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; known tasks: {', '.join(TASKS)}; or {SOURCES}")
    if options:
        raise ValueError(f"task_options has {', '.join(options)}, but the task {name} takes none")
    return TASKS[name]()


__all__ = [
    "SOURCES",
    "TASKS",
    "FetchReach",
    "HalfCheetah",
    "InvertedPendulum",
    "SawyerPush",
    "Task",
    "Walker2d",
    "make_task",
    "robot_spec",
]
