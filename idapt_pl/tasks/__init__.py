"""The tasks, by the names the command line uses."""

from idapt_pl.tasks.inverted_pendulum import InvertedPendulum
from idapt_pl.tasks.task import Task

TASKS: dict[str, type[Task]] = {task.name: task for task in (InvertedPendulum,)}


def make_task(name: str) -> Task:
    """A task by name; the error lists the names there are."""
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; known tasks: {', '.join(TASKS)}")
    return TASKS[name]()


__all__ = ["TASKS", "InvertedPendulum", "Task", "make_task"]
