"""The tasks, by the names the command line uses."""

from idapt_pl.tasks.half_cheetah import HalfCheetah
from idapt_pl.tasks.inverted_pendulum import InvertedPendulum
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.walker2d import Walker2d

TASKS: dict[str, type[Task]] = {task.name: task for task in (InvertedPendulum, HalfCheetah, Walker2d)}


def make_task(name: str) -> Task:
    """A task by name; the error lists the names there are."""
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; known tasks: {', '.join(TASKS)}")
    return TASKS[name]()


__all__ = ["TASKS", "HalfCheetah", "InvertedPendulum", "Task", "Walker2d", "make_task"]
