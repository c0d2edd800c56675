"""The targets that a run can have: a simulation, or whatever can be seen and moved."""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Collection, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import gymnasium

from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.envs import ActionMap, ImageEnv, MappedActions, PixelsOnly, RobotEnv, VectorImageEnv
from idapt_pl.envs.robot_env import RobotSettings
from idapt_pl.tasks import Task


@dataclass(frozen=True)
class Look:
    """How a run looks at its worlds.

    Attributes:
        image_size: side of a frame, pixels.
        frame_stack: K, frames in an observation.
        view: the part of the camera's image that is rendered.
        render_processes: further processes that render.
    """

    image_size: int
    frame_stack: int
    view: View = WHOLE
    render_processes: int = 0

    def simulate(
        self, task: Task, domain: Domain, num_envs: int, variants: Sequence[Domain] = (), whole: bool = False
    ) -> VectorImageEnv:
        """Simulations of a domain, or of variants of it, seen in this way; ``whole`` ones can be restored."""
        return VectorImageEnv(
            task, domain, num_envs, self.image_size, self.frame_stack, self.view, self.render_processes, variants,
            whole=whole,
        )  # fmt: skip


class Target(ABC):
    """Where the policy is to go.

    Attributes:
        name: for file names and reports.
        playable: whether it can be played; if not, it is known from recordings alone.
        measured: whether returns there may be reported; nothing else reads rewards.
        has_states: whether it shows the source's states, so that errors in them can be reported.
        actions: what it is told for the source's actions.
        repeatable: whether a recording that was interrupted can be made again, with the same seed, as it was.
        viewed: whether ``view`` cuts its images as it does the source's.
        mean_actions: whether policies act there with their mean, as exported ones do, where others sample.
        alone: whether there is one of it, so that no two processes may play it at a time.
    """

    name: str
    playable: bool = True
    measured: bool = True
    has_states: bool = False
    viewed: bool = False
    mean_actions: bool = False
    repeatable: bool = True
    alone: bool = False
    actions: ActionMap

    def with_reward(self, num_envs: int, look: Look, asking: bool = True) -> ImageEnv:
        """The target with its reward, ``num_envs`` times at most.

        Args:
            num_envs: how many are asked for.
            look: how the run looks at it.
            asking: whether a person who judges its episodes is asked.

        Raises:
            ValueError: of targets that cannot be played.
        """
        raise ValueError(f"the target {self.name} is known from recordings alone, and cannot be played")

    def look_for(self, look: Look, recorded: Collection[int] = ()) -> None:  # noqa: B027  simulations are there
        """See whether it is there, before anything trains for it; no control step is taken, and no robot moved.

        Args:
            look: how the run looks at it.
            recorded: grounding steps of which the run has its recordings.

        Raises:
            ValueError: it is not, or cannot be drawn.
            RuntimeError: the same, of a user's own code.
        """

    def posable_twin(self, look: Look) -> VectorImageEnv | None:
        """A simulation of the target that can be put into the source's states; None if there is none."""
        return None


@dataclass(frozen=True)
class SimulatedTarget(Target):
    """Another domain of the source's task.

    Attributes:
        task: the source's.
        domain: the target domain.
    """

    task: Task
    domain: Domain
    has_states: bool = True
    viewed: bool = True

    @property
    def actions(self) -> ActionMap:  # type: ignore[override]
        model = self.domain.compile()
        low, high = model.actuator_ctrlrange.T
        return ActionMap.from_config({}, low, high, [model.actuator(i).name for i in range(model.nu)])

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.domain.name

    def with_reward(self, num_envs: int, look: Look, asking: bool = True) -> VectorImageEnv:
        return look.simulate(self.task, self.domain, num_envs)

    def posable_twin(self, look: Look) -> VectorImageEnv:
        return self.with_reward(1, look)


@dataclass(frozen=True)
class OtherTaskTarget(Target):
    """The source of another task: somebody else's model of the same machine.

    Attributes:
        name: as of :class:`Target`.
        task: whose model, start, reward and end they are.
        actions: the source's to its own.
    """

    name: str
    task: Task
    actions: ActionMap
    viewed: bool = True

    def with_reward(self, num_envs: int, look: Look, asking: bool = True) -> ImageEnv:
        env = look.simulate(self.task, self.task.domain("source"), num_envs)
        return MappedActions(PixelsOnly(env), self.actions)

    def look_for(self, look: Look, recorded: Collection[int] = ()) -> None:
        draw_once(self.with_reward(1, look, asking=False))


@dataclass(frozen=True)
class RobotTarget(Target):
    """Any Gymnasium environment that can be seen.

    Attributes:
        name: as of :class:`Target`.
        make: makes the environment.
        find: imports what makes it, where that is a user's.
        simulated: whether it is known to be a simulation, which anybody may reset at any time.
        settings: how it is played.
        actions: the source's to its own.
        measured, repeatable, alone: as of :class:`Target`.
    """

    name: str
    make: Callable[[], gymnasium.Env]
    find: Callable[[], object]
    simulated: bool
    settings: RobotSettings
    actions: ActionMap
    measured: bool = False
    repeatable: bool = False
    alone: bool = True

    def with_reward(self, num_envs: int, look: Look, asking: bool = True) -> ImageEnv:
        settings = replace(self.settings, asked=self.settings.asked and asking)
        env = RobotEnv(self.make, settings, look.image_size, look.frame_stack)
        return MappedActions(env, self.actions)

    def look_for(self, look: Look, recorded: Collection[int] = ()) -> None:
        if self.simulated:
            draw_once(self.with_reward(1, look, asking=False))
        else:
            self.find()


def draw_once(env: ImageEnv) -> None:
    """Draw the first image of an episode."""
    with closing(env):
        env.reset(seed=0)
