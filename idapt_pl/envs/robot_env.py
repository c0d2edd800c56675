"""Any Gymnasium environment that can be seen, as the run sees its targets: one robot, square images, stacked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from datamodules.images.fitting import Fitted
from datamodules.users_error import UsersError
from idapt_pl.envs.image_env import ResetResult, StepResult
from idapt_pl.envs.patient import NoAnswer, Patient

STEP_RETURNS = "observation, reward, terminated, truncated, info"


class TargetFailed(RuntimeError):
    """A target could not be reset, stepped or seen; what was recorded before is kept."""


@dataclass(frozen=True)
class RobotSettings:
    """How a robot is played.

    Attributes:
        name: for messages.
        horizon: control steps after which an episode is cut.
        period: control period, s.
        repeat: steps of the environment in a control step.
        pixels: key of its images, where it shows several things.
        attended: wait for a person before every reset.
        patience: seconds that a step, and a reset that is not attended, may take.
        success: whether ``info`` says ``success`` or ``is_success``, for tasks whose metric that is.
        asked: ask a person how an episode went, in place of rewards and ``info``.
        rewarded: whether rewards are read.
    """

    name: str
    horizon: int
    period: float
    repeat: int = 1
    pixels: str | None = None
    attended: bool = False
    patience: float = 120.0
    success: bool = False
    asked: bool = False
    rewarded: bool = True


class RobotEnv(gymnasium.vector.VectorEnv):
    """A Gymnasium environment as a vector of one, with observations of the last K images, uint8 (1, K, S, S, 3).

    Images of any size are cropped to a square in their middle and scaled. Where observations are no images the
    environment's own :meth:`~gymnasium.Env.render` is shown. Actions are float32 (1, nu), clipped to its bounds.

    Args:
        make: makes the environment.
        settings: how it is played.
        image_size: S.
        frame_stack: K.

    Raises:
        TargetFailed: if it cannot be made.
        ValueError: if it is not one that can be seen and moved.
    """

    single_action_space: gymnasium.spaces.Box
    single_observation_space: gymnasium.spaces.Dict
    observation_space: gymnasium.spaces.Dict

    def __init__(
        self, make: Callable[[], gymnasium.Env], settings: RobotSettings, image_size: int, frame_stack: int
    ) -> None:
        self.settings, self.num_envs = settings, 1
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self._patient, self._fit = Patient(), Fitted(image_size, image_size, "crop")
        self._hangs = False
        self._robot = self._ask("be made", settings.patience, make)
        check_robot(settings, self._robot)
        self._shape: tuple[int, ...] | None = None
        self._frames = np.zeros((1, frame_stack, image_size, image_size, 3), np.uint8)
        self._elapsed, self._reset_already = 0, False
        self._stopped: BaseException | None = None
        space = self._robot.action_space
        self.single_action_space = gymnasium.spaces.Box(np.ravel(space.low), np.ravel(space.high), dtype=np.float32)
        pixels = gymnasium.spaces.Box(0, 255, self._frames.shape[1:], np.uint8)
        self.single_observation_space = gymnasium.spaces.Dict({"pixels": pixels})
        self.action_space = batch_space(self.single_action_space, 1)
        self.observation_space = cast(gymnasium.spaces.Dict, batch_space(self.single_observation_space, 1))

    @property
    def dt(self) -> float:
        """Control period, s."""
        return self.settings.period

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin a new episode; one that :meth:`step` has just begun is gone on with, as a reset can cost a walk.

        Raises:
            TargetFailed: if it cannot be begun.
        """
        self._raise_what_stopped_it()
        if self._reset_already:
            self._reset_already = False
            return {"pixels": self._frames.copy()}, {}
        if self.settings.attended:
            wait_for_person(self.settings.name)
        patience = None if self.settings.attended else self.settings.patience
        told = self._ask("be reset", patience, self._robot.reset, seed=seed)
        observation, _ = self._whole("reset", told, "observation, info")
        self._elapsed = 0
        self._frames[:] = self._see(observation)
        return {"pixels": self._frames.copy()}, {}

    def step(self, actions: np.ndarray) -> StepResult:
        """A control step.

        Raises:
            TargetFailed: if it cannot be made, or what comes back is no image of the same size.
        """
        self._raise_what_stopped_it()
        space = self._robot.action_space
        action = np.clip(actions[0].reshape(space.shape), space.low, space.high).astype(space.dtype)
        reward, over, cut, infos = 0.0, False, False, {}
        for _ in range(self.settings.repeat):
            told = self._ask("take a step", self.settings.patience, self._robot.step, action)
            observation, gained, over, cut, infos = self._whole("step", told, STEP_RETURNS)
            reward += self._reward(gained)
            if over or cut:
                break
        self._elapsed += 1
        self._frames[:, :-1] = self._frames[:, 1:]
        self._frames[:, -1] = self._see(observation)
        cut = bool(cut or self._elapsed >= self.settings.horizon) and not over
        seen: dict[str, Any] = {}
        if self.settings.success:
            seen["success"] = np.array([bool(infos.get("success", infos.get("is_success", False)))])
        if self.settings.asked:
            reward, seen = self.judged(over or cut)
        if over or cut:
            seen |= {"final_obs": {"pixels": self._frames.copy()}, "_final_obs": np.array([True])}
            self._reset_already = False
            try:
                self.reset()
            except BaseException as stopped:  # this step was taken, and is told of first
                self._stopped = stopped
        self._reset_already = bool(over or cut) and self._stopped is None
        ends = np.array([bool(over)]), np.array([cut])
        return {"pixels": self._frames.copy()}, np.array([reward]), *ends, seen

    def judged(self, ended: bool) -> tuple[float, dict[str, Any]]:
        """Reward and what else is told of a step, by a person who is asked once, where the episode ends."""
        told = ask_person(self.settings.name, self.settings.success) if ended else 0.0
        return told, {"success": np.array([told > 0])} if self.settings.success else {}

    def _reward(self, gained: Any) -> float:
        """A reward as a number; what nobody reads may be anything.

        Raises:
            TargetFailed: if it is measured and no finite number.
        """
        if not self.settings.rewarded:
            return 0.0
        try:
            reward = float(np.asarray(gained, float).item())
        except (TypeError, ValueError):
            reward = np.nan
        if not np.isfinite(reward):
            raise TargetFailed(f"target {self.settings.name} gives the reward {gained!r}; expected a finite number")
        return reward

    def _raise_what_stopped_it(self) -> None:
        stopped, self._stopped = self._stopped, None
        if stopped is not None:
            raise stopped

    def close_extras(self, **kwargs: Any) -> None:
        try:
            if not self._hangs:  # or it would be waited for again
                self._ask("be closed", self.settings.patience, self._robot.close)
        finally:
            if not isinstance(self._stopped, TargetFailed):
                self._raise_what_stopped_it()  # a person did

    def _ask(self, what: str, seconds: float | None, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call the robot; whatever goes wrong is said to be its."""
        try:
            return self._patient(function, *args, seconds=seconds, **kwargs)
        except UsersError:
            raise
        except Exception as error:
            said = str(error) or type(error).__name__
            if isinstance(error, NoAnswer):
                self._hangs = True
                said += f". If it needs longer, resume with --target.patience {2 * self.settings.patience:g}"
            raise TargetFailed(f"target {self.settings.name} could not {what}: {said}") from error

    def _whole(self, method: str, told: Any, parts: str) -> tuple[Any, ...]:
        """What a method returned, if it is as many values as Gymnasium's returns; before version 0.26 it was not."""
        expected = parts.split(", ")
        if isinstance(told, tuple) and len(told) == len(expected):
            return told
        came = f"{len(told)} values" if isinstance(told, tuple) else type(told).__name__
        raise TargetFailed(
            f"target {self.settings.name}: its {method} returned {came}; expected {len(expected)}, as Gymnasium has "
            f"them: {parts}"
        )

    def _see(self, observation: Any) -> np.ndarray:
        """The image of an observation, uint8 (S, S, 3)."""
        name = self.settings.name
        image = find_image(observation, self.settings.pixels)
        if image is None:
            image = self._ask("be drawn", self.settings.patience, self._robot.render)
        try:
            image = as_image(image)
        except ValueError as error:
            raise TargetFailed(f"target {name} shows {error}") from None
        if self._shape is not None and image.shape != self._shape:
            raise TargetFailed(f"target {name}: its images were {self._shape} and are {image.shape} now")
        self._shape = image.shape
        return self._fit(image)


def check_robot(settings: RobotSettings, robot: Any) -> None:
    """Whether an environment can be seen and moved.

    Raises:
        ValueError: saying what is missing.
    """
    name = settings.name
    if not isinstance(robot, gymnasium.Env):
        raise ValueError(f"target {name} is {type(robot).__name__}, not a gymnasium.Env")
    space = robot.action_space
    if not isinstance(space, gymnasium.spaces.Box) or not np.isfinite([space.low, space.high]).all():
        raise ValueError(f"target {name}: its action_space is {space}; it must be a Box with finite bounds")
    seen = robot.observation_space
    parts = seen.spaces if isinstance(seen, gymnasium.spaces.Dict) else {"": seen}
    images = [key for key, part in parts.items() if looks_like_image(part.shape)]
    if settings.pixels is not None and settings.pixels not in parts:
        raise ValueError(f"target {name} shows no {settings.pixels!r}; it shows: {', '.join(parts)}")
    if settings.pixels is None and len(images) > 1:
        raise ValueError(f"target {name} shows several images; give target.pixels one of: {', '.join(images)}")
    if settings.pixels is None and not images and robot.render_mode != "rgb_array":
        raise ValueError(
            f"target {name} shows no images: its observations are {seen}, and its render_mode is {robot.render_mode}, "
            "not rgb_array"
        )


def looks_like_image(shape: tuple[int, ...] | None) -> bool:
    """Whether a space's shape is an image's: (H, W), (H, W, 1, 3 or 4) or (3, H, W)."""
    if shape is None or len(shape) not in (2, 3) or min(sorted(shape)[-2:]) < 8:
        return False
    return len(shape) == 2 or shape[-1] in (1, 3, 4) or shape[0] in (1, 3)


def find_image(observation: Any, key: str | None) -> Any:
    """The image in an observation; None if there is none in it."""
    if isinstance(observation, Mapping):
        keys = [key] if key is not None else [k for k, v in observation.items() if looks_like_image(np.shape(v))]
        return observation[keys[0]] if keys else None
    return observation if looks_like_image(np.shape(observation)) else None


def as_image(image: Any) -> np.ndarray:
    """An image as uint8 (H, W, 3); what a fourth channel says of opacity is left out.

    Raises:
        ValueError: naming what it is instead.
    """
    image = np.asarray(image)
    if not looks_like_image(image.shape):
        raise ValueError(f"no image, but an array {image.shape}")
    if image.ndim == 3 and image.shape[-1] not in (1, 3, 4):
        image = np.moveaxis(image, 0, -1)
    if image.ndim == 3 and image.shape[-1] == 4:
        image = image[..., :3]
    if image.ndim == 2:
        image = image[..., None]
    if image.dtype != np.uint8:
        if not np.isfinite(image).all() or image.min() < 0 or image.max() > 1:
            raise ValueError(f"an image of {image.dtype} that is not within 0 and 1; give uint8, or floats from 0 to 1")
        image = np.round(255 * image).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)))


def wait_for_person(name: str) -> None:
    """Ask for a reset by hand.

    Raises:
        TargetFailed: if nobody can answer.
    """
    try:
        input(f"Reset {name} by hand, then press Enter (Ctrl-C to stop; the run can be resumed): ")
    except EOFError:
        raise TargetFailed(
            f"target {name} is attended, and nobody is there: run in a terminal, or set target.attended: false"
        ) from None


def ask_person(name: str, success: bool) -> float:
    """How an episode went: 1 or 0 for success, else a number.

    Raises:
        TargetFailed: if nobody can answer.
    """
    question = "Was the goal reached (y or n)? " if success else "What was its return (a number)? "
    while True:
        try:
            said = input(f"An episode of {name} is over. {question}").strip().lower()
        except EOFError:
            raise TargetFailed(
                f"target {name} is judged by a person, and nobody is there: run in a terminal, or set "
                "target.measure: false"
            ) from None
        try:
            told = {"y": 1.0, "yes": 1.0, "n": 0.0, "no": 0.0}[said] if success else float(said)
        except (KeyError, ValueError):
            continue
        if np.isfinite(told):
            return told
