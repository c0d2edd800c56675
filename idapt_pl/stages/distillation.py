"""A privileged teacher (optional): SAC on the source's states, imitated by the image policy before its own SAC."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from datamodules import ReplayBuffer, ReplayDataModule
from datamodules.unpaired import labelled_stacks, read_all
from idapt_pl.envs import ImageEnv, KeptNear, StatesOnly
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, Imitation, StateSAC
from idapt_pl.nets.devices import on_device
from idapt_pl.nets.units import Units, take_in_units
from idapt_pl.ranges import COUNT_OR_NONE, NOT_NEGATIVE, Range, check_ranges
from idapt_pl.rl.dagger import DaggerExperience
from idapt_pl.rl.experts import fit_expert
from idapt_pl.rl.noisy_teacher import noisy_return
from idapt_pl.rl.returns import evaluate
from idapt_pl.stage import Stages
from idapt_pl.stages.aside import Aside, in_turn
from idapt_pl.tasks.recipe import ExpertRecipe
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)

OFTEN_ENOUGH = 0.95
"""Share of the source's episodes in which a teacher must reach the goal, or another one is trained."""

TRIALS, GOALS = 20, 100
"""Episodes by which teachers are compared: of their returns, and of the share that reaches the goal."""

LABELLED = ("observation", "label", "label_log_std")
"""What imitation learns from."""


@dataclass(frozen=True)
class TeacherSettings:
    """A teacher that sees the source's states, and how the image policy learns from it. Off unless ``steps`` are given.

    Args:
        steps: environment steps of the teacher's SAC in the source, where states are free; 0 is no teacher, the paper.
        adapt: environment steps for which it goes on whenever the dynamics have become other ones: in the grounded
            source with F, or in a repaired source. 0 leaves it as it was. Either comes after the warm-up of its recipe.
        dagger: environment steps of DAgger (Ross et al. 2011) at the beginning of every policy stage. The policy's own
            SAC follows, as long as the schedule says; 0 leaves the student as it is.
        rehearse: in place of DAgger, environment steps in which encoder and filter learn the policy's motions. Its head
            is the teacher's own, which acts on estimates of the state (:mod:`~idapt_pl.stages.on_estimates`).
        rounds: rehearsals of the policy's own motions in every grounded source, after that of its last teacher's there.
            What is seen of the newest makes the next one better (DAgger's iterations, Ross et al. 2011, for estimates).
        noise: spread of slow noise on the states that the teacher's actor sees while it trains, in units of their
            spread; its critics see the true ones. So it learns to live with errors of estimates. 0 for none.
        offset: spread of errors that stay for a whole episode, likewise. What G misplaces, it misplaces in every image.
        strays: share of DAgger's steps in which random actions, held for some steps each, are played in place of
            anybody's. So the student learns the way back from where its errors lead.
        fading: share of DAgger's steps over which the teacher's share of the actions falls from 1 to 0.
        updates_per_step: minibatches (of ``feeding.policy_batch``) that the student learns from for each of them.
        harden: environment steps for which every new teacher of the grounded source goes on with the errors that
            estimates had in its rehearsals there (:class:`.RecordedErrors`), in half of its episodes if there is
            ``noise`` or ``offset``. Encoder and filter rehearse again after.
        horizon: control steps after which its episodes are cut while it trains in a repaired source, as by a time
            limit, but not while it is hardened or where there is an F; 0 is the task's. A robot that fell, and whose
            episode goes on, otherwise learns mostly how to get along on its back. In the plain source it may: such a
            teacher shows more poses where it explores.
        candidates: teachers that are trained, with other random numbers, where the source was repaired. The one goes on
            that earns most there, on states as wrong as in training.
        afresh: how many of these, the last ones, begin anew: what was learned in the plain source can be in the way.
        unfamiliarity_cost: taken off its reward while it trains, where a state is unlike those of the source's
            task-agnostic data (:class:`.KeptNear`). Without, it may go where no image was ever seen, if the task lets
            it. A teacher that is trained before these data has none of it.
        attempts: of tasks whose metric is success, teachers of the plain source that are trained at most, one after
            another with other random numbers, until one reaches the goal in 95 % of 100 episodes there.
    """

    steps: int = 0
    adapt: int = 0
    dagger: int = 0
    rehearse: int = 0
    rounds: int = 1
    noise: float = 0.0
    offset: float = 0.0
    strays: float = 0.0
    fading: float = 0.5
    updates_per_step: float = 1.0
    harden: int = 0
    horizon: int = 0
    candidates: int = 1
    afresh: int = 0
    attempts: int = 3
    unfamiliarity_cost: float = 0.0

    def __post_init__(self) -> None:
        ranges = dict.fromkeys(("steps", "adapt", "dagger", "rehearse", "harden", "horizon"), COUNT_OR_NONE)
        errors = dict.fromkeys(("noise", "offset", "unfamiliarity_cost"), NOT_NEGATIVE)
        check_ranges(
            "teacher",
            vars(self),
            ranges
            | errors
            | {"strays": Range(0, 0.9), "updates_per_step": Range(0, 1e6, "(]")}
            | dict.fromkeys(("candidates", "attempts", "rounds"), Range(1, 100)),
        )
        check_ranges("teacher", {"afresh": self.afresh}, {"afresh": Range(0, self.candidates)})
        if bool(self.steps) != bool(self.dagger or self.rehearse) or (self.dagger and self.rehearse):
            raise ValueError(
                f"teacher.steps is {self.steps}, teacher.dagger {self.dagger} and teacher.rehearse {self.rehearse}: "
                "a teacher trains (steps) and is imitated (dagger) or acts on estimates (rehearse). Give both: steps "
                "and one of these, or none."
            )
        if self.harden and not self.rehearse:
            raise ValueError(
                f"teacher.harden is {self.harden}, but teacher.rehearse is 0: errors are measured in rehearsals. "
                "Give both, or teacher.harden 0"
            )
        if self.strays and not self.dagger:
            raise ValueError(
                f"teacher.strays is {self.strays}, but they are DAgger's: give teacher.dagger, or no strays"
            )
        if not 0 < self.fading <= 1:
            raise ValueError(f"teacher.fading is a share, above 0 and up to 1; got {self.fading}")

    def in_the_source(self) -> TeacherSettings:
        """The same teacher where no source is ever repaired or grounded: all its steps come before it is imitated."""
        return replace(self, steps=self.steps + self.adapt + self.harden, adapt=0, harden=0)


class Distillation:
    """Keeps the teacher of a run up to date and makes students. It knows source and grounded source, not the target.

    Args:
        worlds: of the run.
        stages: of the run.
        settings: how long the teacher trains and is imitated.
        num_envs: simulations that the student acts in side by side.
        batch: labelled observations in a minibatch.
        memory: labelled observations kept.
        aside: starts candidates beside the first one.
    """

    def __init__(
        self, worlds: Worlds, stages: Stages, settings: TeacherSettings, num_envs: int, batch: int, memory: int,
        aside: Aside = in_turn,
    ) -> None:  # fmt: skip
        self.worlds, self.stages, self.settings, self.aside = worlds, stages, settings, aside
        self.num_envs, self.batch, self.memory = num_envs, batch, memory
        self.expert: StateSAC | None = None
        self._first: StateSAC | None = None  # before any adaptation
        self._dynamics: tuple | None = None  # those that the expert was trained in
        self._hardened: StateSAC | None = None

    def student(
        self,
        step: int,
        prefix: str,
        build: Callable[[], AsymmetricSAC],
        make_env: Callable[[torch.device], VectorEnv],
        F: ActionTransformation | None = None,
        labelled: Sequence[Path] = (),
    ) -> AsymmetricSAC:
        """The policy of ``build``, taught in an environment (one whose actions go through F, if there is one).

        Its encoder learns from ``labelled`` trajectory files beside what it sees there.
        """
        teacher = self.up_to_date(step, f"{prefix}teacher", build, make_env, F)

        def build_imitation() -> Imitation:
            policy = build()
            copy_critics(teacher, policy)
            return Imitation(policy)

        def feed(module: Imitation, seed: int, device: torch.device) -> ReplayDataModule:
            t, n, policy = self.settings, self.num_envs, module.policy
            fading = math.ceil(t.fading * t.dagger / n)
            supervised = policy.supervised
            images = round(policy.hparams.estimator_updates * n) if supervised else 0
            experience = DaggerExperience(
                make_env(device), policy, on_device(teacher, device), seed, fading, images > 0, t.strays
            )
            return ReplayDataModule(
                experience,
                ReplayBuffer(min(self.memory, t.dagger), seed),
                self.batch,
                updates_per_batch=max(1, round(t.updates_per_step * n)),
                batches=t.dagger // n,
                image_batches=images,
                image_batch_size=policy.hparams.estimator_batch,
                labelled=labelled_stacks(labelled, policy.hparams.frame_stack),
                names=LABELLED,
            )

        steps = self.settings.dagger // self.num_envs
        return self.stages.fit(step, f"{prefix}student", build_imitation, feed, steps).policy

    def up_to_date(
        self,
        step: int,
        name: str,
        build: Callable[[], AsymmetricSAC],
        make_env: Callable[[torch.device], VectorEnv],
        F: ActionTransformation | None,
    ) -> StateSAC:
        """The teacher, trained in the source and after that in whatever dynamics are new."""
        dynamics = (self.worlds.source_domain, F)
        known, fresh = self.expert, self.expert is None
        if known is not None and (dynamics == self._dynamics or not self.settings.adapt):
            return known
        policy = build().hparams  # its critics are to be the student's
        recipe = self.recipe(F, policy.gamma, self.settings.steps if fresh else self.settings.adapt)

        def build_expert(known: StateSAC | None) -> StateSAC:
            bounds: dict[str, Any] = self.worlds.action_bounds
            same = {name: policy[name] for name in ("hidden", "gamma", "actor_every")}
            same |= {"noise": self.settings.noise, "offset": self.settings.offset}
            expert = StateSAC(policy.state_dim, **bounds, **same)
            if known is not None:
                expert.load_state_dict(known.state_dict())
            return expert

        def make(device: torch.device) -> VectorEnv:
            n, cut = recipe.num_envs, 0 if fresh else self.settings.horizon
            return self.kept_near(self.worlds.training_states(n, cut) if F is None else StatesOnly(make_env(device)))

        def train(n: str, anew: bool) -> StateSAC:
            return fit_expert(partial(build_expert, None if anew else known), make, recipe, self.stages, step, n, anew)

        if fresh and self.worlds.task.metric == "success":
            self.expert = self.first_to_succeed(step, name, partial(train, anew=True))
        elif F is None and not fresh:
            self.expert = self.best_of_several(step, name, train)
        else:
            self.expert = train(name, anew=fresh)
        self._dynamics, self._first = dynamics, self._first or self.expert
        return self.expert

    def kept_near(self, env: ImageEnv) -> ImageEnv:
        """The environment with the cost of states unlike those of D^S, if there is one and they are recorded."""
        cost, data = self.settings.unfamiliarity_cost, self.stages.folder(0) / "source.h5"
        if not cost or not data.exists():
            return env
        states = np.concatenate([e.observations["state"] for e in read_all([data])])
        return KeptNear(env, states, cost)

    def first_to_succeed(self, step: int, name: str, train: Callable[[str], StateSAC]) -> StateSAC:
        """A teacher that reaches the task's goal in the source, or the best of all attempts."""
        trained, rates = [train(name)], []
        if self.settings.attempts == 1:
            return trained[0]
        while True:
            rates.append(self.success(step, numbered(f"{name}_success", len(trained)), trained[-1]))
            goals = f"the teacher reaches the goal in {100 * rates[-1]:.0f} % of {GOALS} episodes in the source"
            if rates[-1] >= OFTEN_ENOUGH:
                log.info("step %d  %s", step, goals)
                return trained[-1]
            if len(trained) == self.settings.attempts:
                log.warning("step %d  %s, the best one in %.0f %%. What learns of it cannot do better; a larger "
                            "teacher.steps helps", step, goals, 100 * max(rates))  # fmt: skip
                return trained[int(np.argmax(rates))]
            log.info("step %d  %s: another one is trained", step, goals)
            trained.append(train(numbered(name, len(trained) + 1)))

    def success(self, step: int, name: str, teacher: StateSAC) -> float:
        """Share of the source's episodes in which a teacher reaches the goal."""

        def make(seed: int) -> dict:
            with closing(self.worlds.training_states(TRIALS)) as env:
                return {"success": evaluate(env, lambda seen: teacher.act(seen, deterministic=True), GOALS, seed).mean}

        return float(self.stages.measure(step, name, make)["success"])

    def best_of_several(self, step: int, name: str, train: Callable[[str, bool], StateSAC]) -> StateSAC:
        """The best in the source of all candidates, trained beside one another, the last of which begin anew."""
        count, afresh = self.settings.candidates, self.settings.afresh
        anew = {numbered(name, i): i > count - afresh for i in range(1, count + 1)}
        others = [
            self.aside(f"{n}_of_step_{step}", self.stages.folder(step) / n / "final.ckpt", partial(train, n, anew[n]))
            for n in [*anew][1:]
        ]
        trained = [train(name, anew[name]), *(trained_aside() for trained_aside in others)]
        return trained[self.best_of(step, name, trained)]

    def recipe(self, F: ActionTransformation | None, gamma: float, steps: int) -> ExpertRecipe:
        """The task's, with the student's discount; behind an F it counts the student's simulations."""
        recipe = replace(self.worlds.task.expert, gamma=gamma, steps=steps)
        return recipe if F is None else replace(recipe, num_envs=self.num_envs)

    @property
    def to_be_hardened(self) -> bool:
        """Whether the teacher is one that has not yet learned to bear measured errors, and shall."""
        return self.settings.harden > 0 and self.expert is not self._hardened

    def hardened(
        self, step: int, build: Callable[[], AsymmetricSAC], errors: Callable[[], Sequence[np.ndarray]],
        make_env: Callable[[torch.device], VectorEnv], F: ActionTransformation | None,
    ) -> StateSAC:  # fmt: skip
        """The teacher of :meth:`up_to_date` after it has learned to bear measured errors (T, s)."""
        recipe = self.recipe(F, build().hparams.gamma, self.settings.harden)
        known = self.expert
        assert known is not None  # to_be_hardened

        def make(device: torch.device) -> VectorEnv:
            n = recipe.num_envs
            return self.kept_near(self.worlds.training_states(n) if F is None else StatesOnly(make_env(device)))

        build_expert: Callable[[], StateSAC] = partial(copy.deepcopy, known)
        self.expert = fit_expert(build_expert, make, recipe, self.stages, step, "hardened_teacher", False, errors)
        self._hardened = self.expert
        return self.expert

    def best_of(self, step: int, name: str, trained: Sequence[StateSAC]) -> int:
        """Which of several teachers earns most in the source, on states as wrong as in training."""
        if len(trained) == 1:
            return 0

        def make(seed: int) -> dict:
            with closing(self.worlds.training_states(TRIALS)) as env:
                returns = [round(noisy_return(teacher, env, TRIALS, seed), 2) for teacher in trained]
            log.info("step %d  teachers earn %s in the source; the best goes on", step, returns)
            return {"returns": returns, "chosen": int(np.argmax(returns))}

        return int(self.stages.measure(step, f"{name}_trials", make)["chosen"])

    def of_the_source(self, build: Callable[[], AsymmetricSAC]) -> StateSAC:
        """The teacher as it is before any grounding; it trains now, if it has not yet."""
        if self._first is None:
            return self.up_to_date(
                0, "source_teacher", build, lambda device: self.worlds.training_source(self.num_envs), None
            )
        return self._first


def numbered(name: str, i: int) -> str:
    """The name of the i-th stage of those that are alike, from 1."""
    return name if i == 1 else f"{name}_{i}"


@torch.no_grad()
def copy_critics(teacher: StateSAC, policy: AsymmetricSAC) -> None:
    """Give a policy the teacher's critics and temperature, so that its SAC goes on from where the teacher's ended.

    The teacher's critics see standardised states, the policy's the states: the scale goes into the first layers.
    """
    theirs = Units.of(teacher.actor.encoder)
    plain = Units(torch.zeros_like(theirs.mean), torch.ones_like(theirs.std))
    for name in ("critic", "critic_target"):
        critic = getattr(policy, name)
        critic.load_state_dict(getattr(teacher, name).state_dict())
        for net in critic.nets:
            take_in_units(net[0].weight[:, : len(theirs.mean)], net[0].bias, theirs, plain)
    policy.log_alpha.copy_(teacher.log_alpha)
