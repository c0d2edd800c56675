"""The stages of π: SAC in the source and in the grounded source (Section IV-D), after a teacher if there is one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from gymnasium.vector import VectorEnv

from datamodules import ReplayBuffer, ReplayDataModule
from datamodules.replay import TRANSITION
from datamodules.stacks import FrameStacks
from datamodules.unpaired import labelled_stacks, read_all
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.modules.recurrent_policy import REMEMBERED
from idapt_pl.nets.devices import on_device
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.recurrent_experience import RecurrentExperience
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.encoder import fit_encoder_on
from idapt_pl.stages.on_estimates import fit_on_estimates
from idapt_pl.stages.schedule import StageLengths, length_of
from idapt_pl.stages.trials import GroundedTrials, trial


def fit_source_policy(
    c: StageContext, steps: int, lengths: StageLengths, P_S: StatePredictor, source: Sequence[Path]
) -> AsymmetricSAC:
    """π by SAC (or first a teacher) in the plain source: where everything starts, and what is transferred directly.

    Args:
        c: of the run.
        steps: environment steps of SAC.
        lengths: of encoder and filter, where the teacher acts on estimates.
        P_S: a supervised encoder starts as its copy.
        source: the task-agnostic data, which tell π and its successors what states are familiar.
    """

    def make_env(device: torch.device) -> VectorEnv:
        return c.worlds.training_source(c.batches.num_envs)

    def build() -> AsymmetricSAC:
        return c.new_policy(P_S.P_S)

    initial: AsymmetricSAC | PixelStatePredictor = P_S.P_S
    if c.teacher.settings.rehearse:
        teacher = c.teacher.up_to_date(0, "source_teacher", build, make_env, None)
        start = c.stages.fit(0, "source_start", build, untrained, 0)  # as a stage, which seeds its filter
        initial = fit_on_estimates(c, 0, "source_", lengths, source, teacher, start)
    elif c.teacher.settings.steps:
        initial = c.teacher.student(0, "source_", build, make_env)

    def finish(policy: AsymmetricSAC, device: torch.device, attempt: int) -> dict:
        episodes = c.batches.trial_episodes
        return {"trial_after": trial(policy, make_env(device), episodes)} if episodes else {}

    return fit_policy(c, 0, "source_policy", make_env, steps, initial, source, finish)


def untrained(module: AsymmetricSAC, seed: int, device: torch.device) -> ReplayDataModule:
    """Stands in for the data of a stage of no batches, which asks for none."""
    raise AssertionError("a stage without batches has no data")


def fit_grounded_policy(
    c: StageContext, step: int, lengths: StageLengths, G: VisualTransformation, F: ActionTransformation | None,
    pi: AsymmetricSAC, labelled: Sequence[Path] = (), poses: Sequence[Path] = (),
) -> AsymmetricSAC:  # fmt: skip
    """π by SAC (or first a teacher) in the source seen through G and moved through F, continued from ``pi``.

    Where the teacher acts on estimates, they are learned from ``labelled``, target-like images with states, too, and
    the encoder from ``poses``, target-like images of what no motion brings about. Elsewhere the
    encoder learns from ``labelled``, first from all and then, as π learns, from those of the target alone. With
    ``feeding.trial_episodes`` episodes in the grounded source say whether it trains again, and whether it is put back.
    """

    def make_env(device: torch.device) -> VectorEnv:
        source = c.worlds.training_source(c.batches.num_envs)
        there = on_device(F, device) if F is not None else None
        return c.worlds.grounded_over(source, on_device(G, device), there)

    own = () if c.teacher.settings.rehearse else labelled[1:]  # the target's images; π sees the others as it learns
    if own and lengths.estimator:  # not before effects were sought, which such labels would hide
        pi = fit_encoder_on(c, step, "estimator_replayed", labelled, lengths.estimator, pi)
    initial = pi
    if c.teacher.settings.rehearse:
        teacher = c.teacher.up_to_date(step, "teacher", lambda: c.new_policy(pi), make_env, F)
        initial = fit_on_estimates(c, step, "", lengths, labelled, teacher, pi, G, F, poses)
    elif c.teacher.settings.steps:
        initial = c.teacher.student(step, "", lambda: c.new_policy(pi), make_env, F, own)

    in_source = c.stages.notes(0, "source_policy").get("trial_after")
    trials = GroundedTrials(c.batches.trial_episodes, c.batches.trial_repeats, in_source)

    def finish(policy: AsymmetricSAC, device: torch.device, attempt: int) -> dict:
        return trials(policy, initial, lambda: make_env(device), attempt) if c.batches.trial_episodes else {}

    steps = length_of(lengths.policy)
    return fit_policy(c, step, "policy", make_env, steps, initial, finish=finish, labelled=own)


def fit_policy(
    c: StageContext,
    step: int,
    name: str,
    make_env: Callable[[torch.device], VectorEnv],
    steps: int,
    initial: AsymmetricSAC | PixelStatePredictor,
    familiar: Sequence[Path] = (),
    finish: Callable[[AsymmetricSAC, torch.device, int], dict] = lambda policy, device, attempt: {},
    labelled: Sequence[Path] = (),
) -> AsymmetricSAC:
    """π by SAC in an environment, continued from a policy, or new with an encoder from a predictor.

    Args:
        c: of the run.
        step: grounding step.
        name: of the stage.
        make_env: the environment, with states and rewards.
        steps: environment steps.
        initial: what π starts from.
        familiar: trajectory files whose states are familiar; none leaves what π knows.
        finish: as of :meth:`~idapt_pl.stage.Stages.fit`.
        labelled: trajectory files with states that the encoder learns from, beside what π sees.
    """
    b = c.batches
    fresh = isinstance(initial, PixelStatePredictor)

    def feed(module: AsymmetricSAC, seed: int, device: torch.device) -> ReplayDataModule:
        if familiar:
            states = FrameStacks(read_all(familiar), 1, labels="state").labels
            module.set_familiar_states(torch.from_numpy(states).to(device))
        env = make_env(device)
        recurrent, length = module.hparams.recurrent, module.hparams.sequence
        first = max(math.ceil(b.warmup_steps / b.num_envs), length if recurrent else 0)  # a stretch to begin with
        capacity = max(min(b.buffer_size, b.warmup_steps + steps), first * b.num_envs if recurrent else 0)
        buffer = ReplayBuffer(capacity - capacity % b.num_envs if recurrent else capacity, seed)
        warm_up = (RecurrentExperience if recurrent else Experience)(env, module, seed, random=fresh)
        for _ in range(first):
            buffer.add(warm_up())
        return ReplayDataModule(
            warm_up.itself() if isinstance(warm_up, RecurrentExperience) else Experience(env, module, seed + 1),
            buffer,
            b.policy_batch,
            updates_per_batch=b.updates_per_step * b.num_envs,
            batches=steps // b.num_envs,
            image_batches=round(module.hparams.estimator_updates * b.num_envs) if module.supervised else 0,
            image_batch_size=module.hparams.estimator_batch,
            labelled=labelled_stacks(labelled, module.hparams.frame_stack),
            names=(*TRANSITION, *REMEMBERED) if recurrent else TRANSITION,
            stretch=(length, b.num_envs) if recurrent else None,
        )

    return c.stages.fit(step, name, lambda: c.new_policy(initial), feed, steps // b.num_envs, finish)
