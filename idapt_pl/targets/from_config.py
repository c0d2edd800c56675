"""What ``target`` says in a config."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from idapt_pl.envs import ActionMap
from idapt_pl.envs.robot_env import RobotSettings
from idapt_pl.ranges import Range, check_ranges
from idapt_pl.targets.recorded import RecordedTarget
from idapt_pl.targets.target import OtherTaskTarget, RobotTarget, SimulatedTarget, Target
from idapt_pl.tasks import Task, make_task
from idapt_pl.tasks.named import find_named, make_named
from idapt_pl.tasks.own import look_for_ids

TARGET_KINDS = ("env", "task", "recordings", "by_hand")
"""What a target that is described can be."""

KEYS = {
    "env": {"env", "name", "options", "actions", "horizon", "repeat", "pixels", "attended", "patience", "measure"},
    "task": {"task", "name", "options", "actions"},
    "recordings": {"recordings", "name", "actions"},
    "by_hand": {"by_hand", "name", "actions"},
}
"""Of the description of each kind."""

GYMNASIUMS = "gymnasium:"
"""Before the id of a registered environment."""

SAME_PERIOD = 0.01
"""Share by which the control periods of source and target may differ."""


def make_target(said: str | Mapping[str, Any], task: Task) -> Target:
    """The target that a config describes.

    Args:
        said: the name of a domain, or what else it is (docs/guide/own_robot.md).
        task: of the source.

    Raises:
        ValueError: if there is no such target, or its description makes no sense.
    """
    if isinstance(said, str):
        return SimulatedTarget(task, task.domain(said))
    kind = check_description(said)
    model = task.domain("source").compile()
    name, period = target_name(said), task.period(model)
    low, high = model.actuator_ctrlrange.T
    actuators = [model.actuator(i).name for i in range(model.nu)]
    actions = ActionMap.from_config(said.get("actions") or {}, low, high, actuators)
    if kind == "recordings":
        return RecordedTarget(name, actions, period, files=recording_paths(said["recordings"]))
    if kind == "by_hand":
        return RecordedTarget(name, actions, period, inbox=Path(str(said["by_hand"])))
    if kind == "task":
        other = make_task(said["task"], said.get("options"))
        theirs = other.period(other.domain("source").compile())
        check_period(name, period, theirs, "target.options: {action_repeat: ...}")
        return OtherTaskTarget(name, other, actions)
    settings = RobotSettings(
        name,
        horizon=said.get("horizon", task.horizon),
        period=period,
        repeat=said.get("repeat", 1),
        pixels=said.get("pixels"),
        attended=said.get("attended", False),
        patience=said.get("patience", 120.0),
        success=task.metric == "success",
        asked=said.get("measure") == "ask",
        rewarded=said.get("measure", False) is True,
    )
    make = functools.partial(make_robot, said["env"], dict(said.get("options") or {}), settings)
    simulated = said["env"].startswith(GYMNASIUMS)
    find = functools.partial(find_named, said["env"], gymnasium.Env, "target.env")
    return RobotTarget(name, make, find, simulated, settings, actions, bool(said.get("measure", False)))


def check_description(said: Mapping[str, Any]) -> str:
    """Which kind of target is described.

    Raises:
        ValueError: naming what is missing, unknown or out of range.
    """
    kinds = [kind for kind in TARGET_KINDS if said.get(kind) is not None]
    if len(kinds) != 1:
        raise ValueError(f"target is {dict(said)}; give the name of a domain, or one of {', '.join(TARGET_KINDS)}")
    kind = kinds[0]
    if unknown := set(said) - KEYS[kind]:
        raise ValueError(
            f"target.{', target.'.join(sorted(unknown))}: unknown with target.{kind}; there are: "
            f"{', '.join(sorted(KEYS[kind]))}"
        )
    numbers = {key: said[key] for key in ("horizon", "repeat", "patience") if key in said}
    ranges = {"horizon": Range(1, 1e6), "repeat": Range(1, 1000), "patience": Range(0, 1e6, "(]")}
    for key, value in numbers.items():
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise ValueError(f"target.{key} is {value!r}; give a number")
    check_ranges("target", numbers, {key: ranges[key] for key in numbers})
    if said.get("measure", False) not in (True, False, "ask"):
        raise ValueError(
            f"target.measure is {said['measure']!r}; give true (its rewards are reported), ask (a person says how each "
            "episode went) or false"
        )
    for key in ("options", "actions"):
        if said.get(key) is not None and not isinstance(said[key], Mapping):
            raise ValueError(f"target.{key} is {said[key]!r}; give keys and values")
    return kind


def recording_paths(said: Any) -> tuple[Path, ...]:
    """The recordings that are listed; whether they are there is seen when they are read.

    Raises:
        ValueError: if it is no list of files and folders.
    """
    listed = [said] if isinstance(said, str) else said
    if not isinstance(listed, Sequence) or not listed or not all(isinstance(path, str) for path in listed):
        raise ValueError(f"target.recordings is {said!r}; give a file or folder for each grounding step")
    return tuple(map(Path, listed))


def target_name(said: str | Mapping[str, Any]) -> str:
    """What a target is called in file names and reports."""
    if isinstance(said, str):
        return said
    if name := said.get("name") or said.get("env") or said.get("task"):
        return str(name)
    return "recordings" if said.get("recordings") else "by hand"


def make_robot(path: str, options: dict[str, Any], settings: RobotSettings) -> gymnasium.Env:
    """The environment that an import path, or ``gymnasium:ID``, names.

    Raises:
        ValueError: if there is none, or its control period is another.
    """
    if path.startswith(GYMNASIUMS):
        env_id = path.removeprefix(GYMNASIUMS)
        look_for_ids(env_id, f"target.env {path}")
        try:
            env = gymnasium.make(env_id, **({"render_mode": "rgb_array"} | options))
        except (gymnasium.error.Error, TypeError, ImportError) as error:
            raise ValueError(f"gymnasium.make says: {error}") from error
    else:
        env = make_named(path, gymnasium.Env, "target.env", options)
    period = getattr(env.unwrapped if isinstance(env, gymnasium.Env) else env, "dt", None)
    if isinstance(period, float | np.floating):
        check_period(settings.name, settings.period, settings.repeat * float(period), "target.repeat")
    return env


def check_period(name: str, source: float, target: float, cure: str) -> None:
    """Whether a control step is as long in the target as in the source.

    Raises:
        ValueError: if it is not.
    """
    if abs(target - source) > SAME_PERIOD * source:
        raise ValueError(
            f"a control step of the target {name} is {target:g} s long, the source's {source:g} s. Make them alike, by "
            f"task_options: {{action_repeat: ...}} or {cure}"
        )
