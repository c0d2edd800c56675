"""The tasks, by the names the command line uses."""

from idapt_pl.tasks.fetch_reach import FetchReach
from idapt_pl.tasks.half_cheetah import HalfCheetah
from idapt_pl.tasks.inverted_pendulum import InvertedPendulum
from idapt_pl.tasks.sawyer_push import SawyerPush
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.walker2d import Walker2d

_ALL = (InvertedPendulum, HalfCheetah, Walker2d, FetchReach, SawyerPush)
TASKS: dict[str, type[Task]] = {task.name: task for task in _ALL}


def make_task(name: str) -> Task:
    """A task by name.

    Raises:
        ValueError: if there is none; the message lists the names there are.
    """
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}; known tasks: {', '.join(TASKS)}")
    return TASKS[name]()


__all__ = ["TASKS", "FetchReach", "HalfCheetah", "InvertedPendulum", "SawyerPush", "Task", "Walker2d", "make_task"]
