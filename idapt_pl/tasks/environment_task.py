"""What tasks share that are made of somebody else's environment on MuJoCo."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.visual import CAMERA, CameraPose
from idapt_pl.tasks.recipe import ExpertRecipe
from idapt_pl.tasks.task import Task
from idapt_pl.tasks.told_motion import ToldMotion, find_told_motion, unseen_joints

WITHOUT_LIMIT = 1000
"""Steps after which an episode is cut where an environment has no time limit."""


class EnvironmentTask(Task):
    """A task whose model, start, state, reward and end are those of an environment that knows nothing of this project.

    Its one domain is ``source``. Effects can be added to it, and the environment goes on with the changed model.

    Args:
        name: as on the command line.
        frame_skip: physics steps that an action is held for.
        limit: steps of the environment after which an episode is cut.
        action_repeat: how many of its steps a control step has; their rewards are summed.
        camera: name of the model's camera to look through, or where to look from (``azimuth``, ``elevation``,
            ``distance``, ``lookat``, ``fovy``). None for the environment's own, or MuJoCo's free one.
        expert_steps: control steps that a policy on true states is trained for, as a bound and for datasets.
    """

    def __init__(
        self,
        name: str,
        frame_skip: int,
        limit: int,
        action_repeat: int = 1,
        camera: str | Mapping[str, Any] | None = None,
        expert_steps: int | None = None,
    ) -> None:
        if action_repeat < 1:
            raise ValueError(f"task_options.action_repeat is {action_repeat}; give 1 or more")
        self.name, self.frame_skip, self.action_repeat = name, frame_skip, action_repeat
        self.horizon, self.camera = max(1, limit // action_repeat), camera
        if expert_steps is not None:
            self.expert = ExpertRecipe(expert_steps)
        self._told: ToldMotion | None = None

    @abstractmethod
    def load(self) -> mujoco.MjSpec:
        """The environment's model, as it is."""

    def free_camera(self, model: mujoco.MjModel) -> CameraPose:
        """Where to look from if the model has no camera: MuJoCo's free camera."""
        view = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, view)
        return CameraPose(CAMERA, view.azimuth, view.elevation, view.distance, tuple(view.lookat.tolist()))

    def usual_camera(self, names: list[str]) -> str | None:
        """Which of the model's cameras the environment looks through; None for the free one."""
        return None

    def base(self) -> mujoco.MjSpec:
        spec = self.load()
        for motor in spec.actuators:  # effects need names
            motor.name = motor.name or motor.target
        names = [camera.name for camera in spec.cameras]
        if CAMERA in names and self.camera in (None, CAMERA):
            return spec
        if CAMERA in names:
            spec.cameras[names.index(CAMERA)].name = f"{CAMERA} of {self.name}"
        chosen = self.camera or self.usual_camera(names)
        if isinstance(chosen, str):
            if chosen not in names:
                raise ValueError(f"task_options.camera is {chosen!r}; {self.name} has: {', '.join(names) or 'none'}")
            spec.cameras[names.index(chosen)].name = CAMERA
            return spec
        pose = self.free_camera(spec.compile())
        if chosen is not None:
            try:
                pose = replace(pose, **chosen)
            except (TypeError, ValueError) as error:
                raise ValueError(f"task_options.camera: {error}") from None
        spec.worldbody.add_camera(name=CAMERA)
        pose.apply(spec)
        return spec

    def domains(self) -> dict[str, Domain]:
        return {"source": Domain("source", self.base)}

    def look_into_states(self) -> None:
        """Find out what the states tell of positions and velocities, for `rates`, `unseen` and `motion`."""
        model = self.domain("source").compile()
        data = mujoco.MjData(model)
        self.reset(model, data, np.random.default_rng(0))
        self._told = find_told_motion(model, self.state, data)
        if self._told is not None:
            self.rates, self.unseen = self._told.rates, unseen_joints(model, self._told)

    @property
    def tells_positions(self) -> bool:
        return self._told is not None

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        return super().motion(states, period) if self._told is None else self._told.motion(states, period)


def check_actuated(name: str, low: np.ndarray, high: np.ndarray, model: mujoco.MjModel) -> None:
    """Actions must be the commands of the model's actuators, one for each, within their ranges.

    Raises:
        ValueError: if they are not.
    """
    ranges = model.actuator_ctrlrange
    cure = "Write a task of your own, whose `play` makes commands of actions (docs/guide/own_robot.md)"
    if len(low) != model.nu:
        raise ValueError(f"{name} has {len(low)} actions and its model {model.nu} actuators. {cure}")
    if not model.actuator_ctrllimited.all():
        free = [model.actuator(i).name or str(i) for i in np.flatnonzero(~model.actuator_ctrllimited.astype(bool))]
        raise ValueError(f"actuators of {name} have no ctrlrange: {', '.join(free)}. {cure}")
    if not (np.allclose(low, ranges[:, 0]) and np.allclose(high, ranges[:, 1])):
        raise ValueError(f"actions of {name} are {low} to {high}, commands {ranges[:, 0]} to {ranges[:, 1]}. {cure}")


def check_one_model(name: str, nominal: mujoco.MjModel, model: mujoco.MjModel) -> None:
    """The model of an environment that has begun some episodes must be as it was before.

    Raises:
        ValueError: if it is not.
    """
    if changed := changed_by(nominal, model):
        raise ValueError(
            f"{name} changes its model where an episode begins ({', '.join(changed)}), but a domain has one model. "
            "Write a task of your own, with that in its state (docs/guide/own_robot.md)"
        )


def changed_by(before: mujoco.MjModel, after: mujoco.MjModel) -> list[str]:
    """Fields of a model, other than sizes of buffers, that an environment has changed."""
    changed = []
    for field in dir(before):
        if field.startswith(MODEL_FIELDS):
            a, b = (np.asarray(getattr(model, field)) for model in (before, after))
            if a.shape != b.shape or not np.allclose(a, b, rtol=1e-6, atol=1e-9, equal_nan=True):
                changed.append(field)
    return changed


MODEL_FIELDS = (
    "body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "tendon_", "wrap_", "eq_", "qpos0", "mat_", "light_",
    "hfield_data",
)  # fmt: skip
"""How the names of the fields begin that say what a model is."""


def options_of(options: dict[str, Any]) -> dict[str, Any]:
    """Those of a task's options that :class:`EnvironmentTask` takes, taken out of ``options``."""
    known = ("action_repeat", "camera", "expert_steps")
    return {name: options.pop(name) for name in known if name in options}
