"""The recordings of a run: task-agnostic data D^S and D^T, and what the policy does in target and grounded source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import torch

from datamodules import Trajectories
from datamodules.unpaired import read_all
from idapt_pl.envs import ImageEnv, TargetFailed, VectorStateEnv
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StateSAC, VisualTransformation
from idapt_pl.rl.collect import collect, replay
from idapt_pl.rl.experts import train_expert
from idapt_pl.rl.exploration import EXPLORATION, ExpertAtTheControls, OpenLoopReplay, TakingTurns
from idapt_pl.rl.policy import Acting, Policy, warn_if_lost
from idapt_pl.run_folder.kept_episodes import KeptEpisodes
from idapt_pl.stages.by_hand import ask_for_recording
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.framing import warn_if_outside
from idapt_pl.targets import RecordedTarget

EXPERTS = {"expert": "exploring_expert", "backwards": "exploring_backwards"}
"""Explorations by policies on states, and the stages that train them."""

MakePolicy = Callable[[int], Policy]
"""Seed to policy."""


def explorer(c: StageContext, exploration: str, seed: int, num_envs: int = 1, strays: float = 0.0) -> Policy:
    """The policy that collects D^S and D^T before there is one for the target, by its name in ``schedule``."""
    if exploration == "rehearse":
        teacher = source_teacher(c)
        torch.manual_seed(seed)  # whether it was trained or loaded just now must make no difference
        alongside = VectorStateEnv(c.worlds.task, c.worlds.first_source, num_envs)
        return OpenLoopReplay(teacher, alongside, seed, strays)
    kinds = exploration.split("+")
    experts = {kind: expert_of(c, kind) for kind in kinds if kind in EXPERTS}
    if experts:
        torch.manual_seed(seed)  # likewise
    with closing(c.worlds.source(num_envs)) as env:
        policies: list[Policy] = [
            ExpertAtTheControls(experts[kind], kind) if kind in EXPERTS else EXPLORATION[kind](env, seed)
            for kind in kinds
        ]
    return policies[0] if len(policies) == 1 else TakingTurns(policies, num_envs)


def expert_of(c: StageContext, kind: str) -> StateSAC:
    """An expert of the source, or a policy that is paid for going backwards; trained on states, as a stage."""
    task = c.worlds.task.backwards() if kind == "backwards" else c.worlds.task
    return train_expert(task, c.worlds.first_source, task.expert, c.stages, EXPERTS[kind])


def source_teacher(c: StageContext) -> StateSAC:
    """The teacher as it is before any grounding; training it is a stage of its own."""
    return c.teacher.of_the_source(c.new_policy)


def record_target(
    c: StageContext, k: int, make_policy: MakePolicy, steps: int, horizon: int | None = None,
    seen: Callable[[ImageEnv], ImageEnv] | None = None,
) -> Path:  # fmt: skip
    """``target.h5`` of a grounding step: so many control steps in the target, images and actions, on the ledger.

    What a target that cannot be played again showed before it failed, or the run was stopped, is gone on with. Episodes
    are begun anew after ``horizon`` steps, if that is given. With ``seen`` the policy sees the target through something
    that shows its images as ``source_pixels``; they are what is recorded.

    Raises:
        TargetFailed: if the target fails; the message says what is kept.
    """
    about = f"{c.worlds.task.name} target, step {k}"
    kept = KeptEpisodes(c.stages.folder(k), c.worlds.period, about)

    def make(seed: int) -> Trajectories:
        target = c.worlds.target
        if isinstance(target, RecordedTarget):
            return recorded_elsewhere(c, target, k, make_policy(seed), steps, horizon)
        before = kept.read()
        c.worlds.ledger.count(k, "training", kept.steps)
        if (left := steps - kept.steps) > 0:
            blind = c.worlds.blind_target(k)
            with closing(blind if seen is None else seen(blind)) as env:
                keep = None if target.repeatable else kept.add
                number, images = seed + len(before), "pixels" if seen is None else "source_pixels"
                if before:
                    torch.manual_seed(number)  # or a policy that samples would play the noise of the first part again
                policy = make_policy(number)
                played = collect(env, policy, left, number, about, images, keep, horizon)
                warn_if_lost(getattr(policy, "lost", None), f"step {k}, being recorded in the target")
            before.extend(played)
        return Trajectories(tuple(before), kept.dt, about)

    try:
        path, taken = c.stages.record(k, "target", make)
    except TargetFailed as failure:
        c.worlds.ledger.enter(k, "training", kept.steps)
        raise TargetFailed(
            f"{failure}. {kept.steps} of {steps} control steps of grounding step {k} are kept; when the target works "
            "again, the same command goes on"
        ) from failure
    c.worlds.ledger.enter(k, "training", taken)
    kept.forget()
    return path


def recorded_elsewhere(
    c: StageContext, target: RecordedTarget, k: int, policy: Policy, steps: int, horizon: int | None
) -> Trajectories:
    """What was recorded of the target, before the run or by hand.

    Raises:
        TargetNeeded: if somebody has to record it yet.
    """
    if target.inbox is not None:
        command = f"idapt fit --config {c.stages.run_dir / 'config.yaml'}"
        ask_for_recording(c.worlds, target, k, policy, steps, command, horizon)
    return target.recording(k, c.worlds.look)


def record_source(
    c: StageContext,
    k: int,
    make_policy: MakePolicy,
    steps: int,
    G: VisualTransformation | None = None,
    F: ActionTransformation | None = None,
    name: str = "source",
    horizon: int | None = None,
) -> Path:
    """``<name>.h5`` of a grounding step: source images and states, of a policy in the source behind G and F.

    Warns of parts of the robot that leave the picture, if they did not in what was recorded before.
    """

    def make(seed: int) -> Trajectories:
        about = f"{c.worlds.task.name} source, step {k}"
        with closing(c.worlds.grounded_over(c.worlds.source(1, whole=True), G, F)) as env:
            return collect(env, make_policy(seed), steps, seed, about, "source_pixels", horizon=horizon)

    path = c.stages.record(k, name, make)[0]
    before = c.stages.folder(k - 1) / path.name if k else c.stages.folder(0) / "source.h5"
    warn_if_outside(c.worlds, path, before if before != path else None)
    return path


def replay_in_source(
    c: StageContext, k: int, recordings: Sequence[Path], G: VisualTransformation | None, F: ActionTransformation | None,
    name: str = "source", horizon: int | None = None,
) -> Path:  # fmt: skip
    """``<name>.h5`` of a grounding step: what the source shows and does when the target's actions are played in it.

    Where a policy succeeds in the source and fails in the target, its images differ in what happens and not only in
    looks, and a discriminator asks G to make up the difference. The same actions bring about the same.

    Args:
        c: of the run.
        k: grounding step.
        recordings: trajectory files of the target.
        G: F looks through it; None without F.
        F: actions go through it.
        name: of the file.
        horizon: control steps of each episode that are played; None for all.
    """

    def make(seed: int) -> Trajectories:
        with closing(c.worlds.grounded(1, G if F is not None else None, F)) as env:
            about = f"{c.worlds.task.name} source, the target's actions of step {k}"
            return replay(env, read_all(recordings).episodes, seed, about, "source_pixels", horizon)

    return c.stages.record(k, name, make)[0]


def on_policy(c: StageContext, pi: AsymmetricSAC) -> MakePolicy:
    """π itself, sampling its actions, or with its mean action where it is recorded so."""
    return lambda seed: Acting(pi, c.worlds.target.mean_actions)
