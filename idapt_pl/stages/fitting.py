"""How each module is built, fed and fitted: the stages that Algorithm 1 is made of."""

from __future__ import annotations

import copy
import functools
import logging
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from datamodules import (
    LabelledImages,
    OnPolicyDataModule,
    ReplayBuffer,
    ReplayDataModule,
    Trajectories,
    UnpairedImages,
)
from datamodules.on_policy import encode_all, target_transitions
from datamodules.pieces import held_out, pieces
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from gymnasium.vector import VectorEnv
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, StateSAC, VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.exploration import OpenLoopReplay
from idapt_pl.rl.grounded_rollout import garat_rollout
from idapt_pl.rl.policy import Policy
from idapt_pl.rl.returns import evaluate
from idapt_pl.stage import Stages
from idapt_pl.stages.distillation import NO_TEACHER, Distillation, TeacherSettings
from idapt_pl.stages.settings import BatchSettings, ModuleFactories
from idapt_pl.stages.trajectory_matching import initialise_by_matching
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)


class Fitting:
    """One method for each kind of stage; data come in and a fitted module goes out."""

    def __init__(
        self,
        worlds: Worlds,
        stages: Stages,
        make: ModuleFactories,
        feeding: BatchSettings,
        teacher: TeacherSettings = NO_TEACHER,
    ) -> None:
        self.worlds, self.stages, self.make, self.feeding, self.teacher = worlds, stages, make, feeding, teacher
        f = feeding
        self.teaching = Distillation(worlds, stages, teacher, f.num_envs, f.policy_batch, f.buffer_size)

    def state_predictor(
        self,
        step: int,
        source: Sequence[Path],
        batches: int,
        initial: StatePredictor | None,
        name: str = "state_predictor",
    ) -> StatePredictor:
        """P^S on labelled source images, from scratch or continued from ``initial``."""

        def feed(module: StatePredictor, seed: int, device: torch.device) -> LabelledImages:
            return LabelledImages(source, self.worlds.frame_stack, self.feeding.state_predictor_batch, batches, seed)

        build = continued(lambda: self.make.state_predictor(**self.worlds.dimensions), initial)
        return self.stages.fit(step, name, build, feed, batches)

    def visual(
        self,
        step: int,
        source: Sequence[Path],
        target: Sequence[Path],
        batches: int,
        P_S: StatePredictor,
        initial: VisualTransformation | None,
    ) -> VisualTransformation:
        """G with P^T on unpaired images; P^T starts as a copy of P^S."""

        def build() -> VisualTransformation:
            module = continued(lambda: self.make.visual(**self.worlds.dimensions), initial)()
            if batches or initial is None:  # else P^T stays what was trained with this G
                module.adopt(P_S.P_S)
            return module

        def feed(module: VisualTransformation, seed: int, device: torch.device) -> UnpairedImages:
            stack, size = self.worlds.frame_stack, self.feeding.visual_batch
            resets = max(1, size // 4) if module.hparams.reset_weight else 0
            return UnpairedImages(source, target, stack, size, batches, seed, resets)

        return self.stages.fit(step, "visual", build, feed, batches)

    def dynamics(
        self,
        step: int,
        target: Sequence[Path],
        rollouts: int,
        policy: AsymmetricSAC,
        G: VisualTransformation,
        initial: ActionTransformation | None,
        explore: Callable[[int, int], Policy],
        hold_out: bool = False,
    ) -> ActionTransformation:
        """F with GARAT: grounded rollouts of ``policy`` (and of ``explore``) against the target's transitions.

        ``hold_out`` keeps a share of the newest target file away from F, for :mod:`idapt_pl.stages.rollback`.
        """

        def build() -> ActionTransformation:
            module = self.make.dynamics(encoder=copy.deepcopy(policy.actor.encoder), **self.worlds.action_bounds)
            if initial is not None:  # F continues, on the newest features
                kept = {k: v for k, v in initial.state_dict().items() if not k.startswith("encoder.")}
                module.load_state_dict(kept, strict=False)
            return module

        def feed(F: ActionTransformation, seed: int, device: torch.device) -> OnPolicyDataModule:
            n = self.feeding.garat_envs
            env, head = self.worlds.grounded(n, G.to(device)), policy.to(device).actor
            roll = garat_rollout(
                env,
                lambda features: head(features)[0],
                F,
                self.feeding.garat_rollout // n,
                seed,
                explore(seed, n),
                round(self.feeding.garat_exploring * n),
            )
            transitions = target_transitions(target, F.encode, self.worlds.frame_stack, hold_out)
            if initial is None and self.feeding.garat_start == "matching":
                F.standardise(transitions)
                self.match(F.cpu(), target, hold_out)
                F.to(device)
            return OnPolicyDataModule(roll, transitions, rollouts)

        return self.stages.fit(step, "dynamics", build, feed, rollouts)

    def match(self, F: ActionTransformation, target: Sequence[Path], hold_out: bool = False) -> None:
        """Give F a start by trajectory matching, without what is held out of the newest file."""
        if not isinstance(F.encoder, PixelStatePredictor):
            raise ValueError(
                "feeding.garat_start: matching needs features that are states, i.e. policy.encoder: supervised; "
                "with a learned encoder use garat_start: identity"
            )
        data = FrameStacks(read_all(target), self.worlds.frame_stack)
        f = F.encoder
        states = (encode_all(data, F.encode) * f.std + f.mean).detach()
        actions = torch.zeros(len(data), data.actions.shape[1])
        actions[data.transitions] = torch.from_numpy(data.actions)
        stretch, kept = data.first, np.ones(len(data), bool)
        if hold_out:
            piece = pieces(FrameStacks(read_all(target[-1:]), self.worlds.frame_stack))
            newest = np.arange(len(data)) >= len(data) - len(piece)
            stretch = np.concatenate([data.first[~newest], len(data) + piece])  # windows must not cross a gap
            kept[newest] = ~held_out(piece)
        task, model = self.worlds.task, self.worlds.source_domain.compile()
        seen = states[kept], actions[kept], stretch[kept]
        left = initialise_by_matching(F, task, model, *seen, self.feeding.garat_ridge)
        log.info(
            "F by trajectory matching: %s; left %.3g",
            F.affine.weight.detach().flatten().numpy().round(3).tolist(),
            left,
        )

    def estimator(
        self, step: int, source: Sequence[Path], batches: int, G: VisualTransformation, policy: AsymmetricSAC
    ) -> AsymmetricSAC:
        """π with its encoder regressed on all labelled source images, as G shows them.

        While π trains it meets few states, near those it holds; F and the next policies need estimates that are right
        wherever G has data.
        """
        if not batches:
            return policy

        def translated(seed: int) -> Trajectories:
            seen = read_all(source, also="state")
            episodes = tuple(G.translate_episode(episode) for episode in seen)
            return replace(seen, episodes=episodes, source=f"{seen.source}, as G shows it")

        data, _ = self.stages.record(step, "translated", translated)
        policy = copy.deepcopy(policy)
        estimator = self.make.state_predictor(**self.worlds.dimensions)
        estimator.P_S.load_state_dict(policy.actor.encoder.state_dict())
        estimator = self.state_predictor(step, [data], batches, estimator, "estimator")
        policy.actor.encoder.load_state_dict(estimator.P_S.state_dict())
        return policy

    def policy(
        self,
        step: int,
        name: str,
        make_env: Callable[[torch.device], VectorEnv],
        steps: int,
        initial: AsymmetricSAC | PixelStatePredictor,
        familiar: Sequence[Path] = (),
        finish: Callable[[AsymmetricSAC, torch.device], dict] = lambda policy, device: {},
    ) -> AsymmetricSAC:
        """π by SAC in an environment, continued from a policy, or new with an encoder from a predictor."""
        f = self.feeding
        fresh = isinstance(initial, PixelStatePredictor)

        def feed(module: AsymmetricSAC, seed: int, device: torch.device) -> ReplayDataModule:
            if familiar:
                module.know(torch.from_numpy(FrameStacks(read_all(familiar), 1, labels="state").labels).to(device))
            env = make_env(device)
            buffer = ReplayBuffer(min(f.buffer_size, f.warmup_steps + steps), seed)
            warm_up = Experience(env, module, seed, random=fresh)
            for _ in range(int(np.ceil(f.warmup_steps / f.num_envs))):
                buffer.add(warm_up())
            supervised = module.hparams.encoder == "supervised"
            return ReplayDataModule(
                Experience(env, module, seed + 1),
                buffer,
                f.policy_batch,
                updates_per_batch=f.updates_per_step * f.num_envs,
                batches=steps // f.num_envs,
                image_batches=round(module.hparams.estimator_updates * f.num_envs) if supervised else 0,
                image_batch_size=module.hparams.estimator_batch,
            )

        return self.stages.fit(step, name, lambda: self.build_policy(initial), feed, steps // f.num_envs, finish)

    def build_policy(self, initial: AsymmetricSAC | PixelStatePredictor) -> AsymmetricSAC:
        """A policy as it was, or a new one with an encoder from a predictor."""
        module = self.make.policy(**self.worlds.dimensions, **self.worlds.action_bounds)
        if isinstance(initial, PixelStatePredictor):
            module.start_from(initial)
        else:
            module.load_state_dict(initial.state_dict())
        return module

    def source_teacher(self) -> StateSAC:
        """The teacher as it is before any grounding."""
        return self.teaching.of_the_source(
            lambda: self.make.policy(**self.worlds.dimensions, **self.worlds.action_bounds)
        )

    def rehearsal(self, seed: int, num_envs: int) -> OpenLoopReplay:
        """What the teacher does in the source as it was declared, played without looking."""
        teacher = self.source_teacher()
        torch.manual_seed(seed)  # whether it was trained or loaded just now must make no difference
        return OpenLoopReplay(
            teacher, VectorStateEnv(self.worlds.task, self.worlds.task.domain("source"), num_envs), seed
        )

    def source_policy(self, steps: int, P_S: StatePredictor, source: Sequence[Path]) -> AsymmetricSAC:
        """π by SAC (or first a teacher) in the plain source: where everything starts, and what is transferred directly.

        ``source`` are the task-agnostic data, which tell π and its successors what states are familiar.
        """
        make_env = lambda device: self.worlds.source(self.feeding.num_envs)  # noqa: E731
        initial: AsymmetricSAC | PixelStatePredictor = P_S.P_S
        if self.teacher.steps:
            initial = self.teaching.student(0, "source_", lambda: self.build_policy(P_S.P_S), make_env)
        return self.policy(0, "source_policy", make_env, steps, initial, source)

    def grounded_policy(
        self, step: int, steps: int, G: VisualTransformation, F: ActionTransformation | None, initial: AsymmetricSAC
    ) -> AsymmetricSAC:
        """π by SAC (or first a teacher) in the source seen through G and moved through F."""
        before = initial

        def make_env(device: torch.device) -> VectorEnv:
            return self.worlds.grounded(self.feeding.num_envs, G.to(device), F.to(device) if F is not None else None)

        if self.teacher.steps:
            initial = self.teaching.student(step, "", lambda: self.build_policy(before), make_env, F)

        def finish(policy: AsymmetricSAC, device: torch.device) -> dict:
            episodes = self.feeding.trial_episodes
            return keep_better(policy, initial, make_env(device), episodes) if episodes else {}

        return self.policy(step, "policy", make_env, steps, initial, finish=finish)


def keep_better(policy: AsymmetricSAC, before: AsymmetricSAC, env: VectorEnv, episodes: int) -> dict:
    """Put a policy back to what it was before its training if that does better in the environment it trained in.

    SAC can unlearn: one that holds still for long forgets what to do when it does not.

    Returns:
        Mean returns (or successes) with the mean action: ``trial_before``, ``trial_after``; ``kept``, which of them.
    """
    with closing(env):
        means = [
            evaluate(env, functools.partial(p.act, deterministic=True), episodes, seed=0).mean
            for p in (copy.deepcopy(before).to(policy.device), policy)
        ]
    kept = "before" if means[0] > means[1] else "after"
    if kept == "before":
        policy.load_state_dict(before.state_dict())
        log.info("the policy is kept as it was: %.1f in the grounded source, after more training %.1f", *means)
    return {"trial_before": means[0], "trial_after": means[1], "kept": kept}


def continued(build: Callable[[], torch.nn.Module], initial: torch.nn.Module | None) -> Callable:
    """A builder whose module starts with the weights of ``initial`` (fresh optimizers, by design)."""

    def build_continued() -> torch.nn.Module:
        module = build()
        if initial is not None:
            module.load_state_dict(initial.state_dict())
        return module

    return build_continued
