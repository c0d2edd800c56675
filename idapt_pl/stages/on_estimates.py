"""A policy that is the teacher itself, acting on estimates of the state: nothing is lost in imitation.

Its encoder reads states from images, its filter holds them together over time (:class:`.StateFilter`), and its head is
the teacher's. Encoder and filter learn where states are known, in the grounded source, on the teacher's own motions
and then on the policy's.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import torch

from datamodules import Trajectories
from datamodules.on_policy import encode_all
from datamodules.stacks import FrameStacks
from datamodules.stretches import ReadEpisode, StretchDataModule
from datamodules.unpaired import read_all
from idapt_pl.envs import GroundedEnv
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, FilterTraining, StateSAC, VisualTransformation
from idapt_pl.nets.units import Units, take_in_units
from idapt_pl.rl.collect import collect
from idapt_pl.rl.policy import deterministic
from idapt_pl.rl.rehearsal import Rehearsal
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.distillation import copy_critics, numbered
from idapt_pl.stages.encoder import fit_encoder_on
from idapt_pl.stages.framing import warn_if_outside
from idapt_pl.stages.schedule import StageLengths

SIMULATIONS = 8
"""Side by side, in a rehearsal."""


def fit_on_estimates(
    c: StageContext,
    step: int,
    prefix: str,
    lengths: StageLengths,
    labelled: Sequence[Path],
    teacher: StateSAC,
    start: AsymmetricSAC,
    G: VisualTransformation | None = None,
    F: ActionTransformation | None = None,
    poses: Sequence[Path] = (),
) -> AsymmetricSAC:
    """π: a teacher's head on the estimates of encoder and filter, which rehearse in the source behind G and F.

    Args:
        c: of the run.
        step: grounding step.
        prefix: of the stages' names.
        lengths: of ``rehearsed`` (encoder) and ``filter``, in batches; half of them after each rehearsal.
        labelled: trajectory files with target-like images and states, to learn from beside the rehearsals.
        teacher: on states.
        start: the policy whose encoder and filter go on learning.
        G: shows source images as target images; None where the source is not grounded.
        F: moves the source as the target moves; None is the identity.
        poses: trajectory files with target-like images and states that no motion brings about; for the encoder alone.
    """
    last = not prefix and not c.teacher.to_be_hardened
    rounds = c.teacher.settings.rounds
    pi = in_rehearsals(c, step, prefix, lengths, labelled, teacher, start, G, F, rounds if last else 1, poses)
    if prefix or last:
        return pi
    trial = rehearse(c, step, "trial_rehearsal", teacher, pi, G, F)  # what pi learned from, it reads twice as well

    def grounded(device: torch.device) -> GroundedEnv:
        return c.worlds.grounded_over(c.worlds.training_source(c.batches.num_envs), G, F)

    errors = partial(errors_of_estimates, pi, [trial])
    hardened = c.teacher.hardened(step, partial(c.new_policy, pi), errors, grounded, F)
    return in_rehearsals(c, step, "hardened_", lengths, [*labelled, trial], hardened, pi, G, F, rounds, poses)


def in_rehearsals(
    c: StageContext, step: int, prefix: str, lengths: StageLengths, labelled: Sequence[Path], teacher: StateSAC,
    start: AsymmetricSAC, G: VisualTransformation | None, F: ActionTransformation | None, rounds: int = 1,
    poses: Sequence[Path] = (),
) -> AsymmetricSAC:  # fmt: skip
    """π as of :func:`fit_on_estimates`, with this teacher; ``rounds`` rehearsals are of π itself as it is by then."""
    pi, files = copy.deepcopy(start), list(labelled)
    take_over(teacher, pi)
    for part in ("teacher", *(numbered("policy", i) for i in range(1, rounds + 1))):
        acting = None if part == "teacher" else pi
        files.append(rehearse(c, step, f"{prefix}rehearsal_{part}", teacher, acting, G, F))
        pi = fit_encoder_on(c, step, f"{prefix}estimator_{part}", [*files, *poses], lengths.rehearsed // 2, pi)
        take_over(teacher, pi)
        pi = fit_filter(c, step, f"{prefix}filter_{part}", files, lengths.filter // 2, pi)
    return pi


@torch.no_grad()
def errors_of_estimates(pi: AsymmetricSAC, files: Sequence[Path]) -> list[np.ndarray]:
    """How far estimates are off in labelled episodes, (T+1, s) each, in the states' units, as while the policy acts."""
    assert pi.filter is not None  # policy.memory is above 0
    errors = []
    for episode in read_episodes(pi, files):
        readings, actions = (torch.from_numpy(a)[None].to(pi.device) for a in (episode.readings, episode.actions))
        memory, estimates = pi.filter.begin(1), []
        for reading, memory.action in zip(readings.unbind(1), actions.unbind(1), strict=True):
            estimates.append(pi.filter.step(reading, memory))
        wrong = torch.cat(estimates).cpu() - torch.from_numpy(episode.states)
        errors.append((wrong * pi.actor.encoder.std.cpu()).numpy())
    return errors


def rehearse(
    c: StageContext, step: int, name: str, teacher: StateSAC, policy: AsymmetricSAC | None,
    G: VisualTransformation | None, F: ActionTransformation | None,
) -> Path:  # fmt: skip
    """``<name>.h5``: what the source behind G and F shows of the teacher's motions, or of the policy's, with states.

    Warns of parts of the robot that leave the picture in the teacher's.
    """

    def make(seed: int) -> Trajectories:
        source = c.worlds.training_source(SIMULATIONS, whole=policy is None)
        with closing(c.worlds.grounded_over(source, G, F)) as env:
            act = Rehearsal(source, teacher, seed, deterministic(policy) if policy is not None else None)
            return collect(env, act, c.teacher.settings.rehearse // 2, seed, f"rehearsal in the source, step {step}")

    path = c.stages.record(step, name, make)[0]
    if policy is None:
        warn_if_outside(c.worlds, path, c.stages.folder(step - 1) / path.name if step else None)
    return path


def fit_filter(
    c: StageContext, step: int, name: str, files: Sequence[Path], batches: int, pi: AsymmetricSAC
) -> AsymmetricSAC:
    """π with its filter fitted to what its encoder reads from labelled files."""

    def feed(module: FilterTraining, seed: int, device: torch.device) -> StretchDataModule:
        s = c.filter
        return StretchDataModule(read_episodes(module.policy, files), s.stretch, s.batch, batches, seed)

    def build() -> FilterTraining:
        s = c.filter
        return FilterTraining(copy.deepcopy(pi), s.lr, s.gain, s.offset, s.noise, s.dropout)

    return c.stages.fit(step, name, build, feed, batches).policy


def read_episodes(pi: AsymmetricSAC, files: Sequence[Path]) -> list[ReadEpisode]:
    """Labelled episodes as a policy's encoder reads them; states standardised as its readings are."""
    data = read_all(files, also="state")
    stacks = FrameStacks(data, pi.hparams.frame_stack, labels="state")
    assert stacks.labels is not None  # asked for
    readings = encode_all(stacks, pi.encode).numpy()
    states = pi.actor.encoder.standardise(torch.from_numpy(stacks.labels).to(pi.device)).cpu().numpy()
    episodes, first = [], 0
    for episode in data:
        rows = slice(first, first := first + len(episode) + 1)
        taken = pi.actor.normalise(torch.from_numpy(episode.actions).float().to(pi.device)).cpu().numpy()
        before = np.concatenate([np.zeros_like(taken[:1]), taken])
        episodes.append(ReadEpisode(readings[rows], before, states[rows]))
    return episodes


@torch.no_grad()
def take_over(teacher: StateSAC, policy: AsymmetricSAC) -> None:
    """Give a policy the teacher's head, critics and temperature.

    The teacher's head sees states in units of its own, the policy's in those of the encoder: the first layer turns the
    one into the other.
    """
    copy_critics(teacher, policy)
    head, mine, theirs = policy.actor.head, policy.actor.encoder, teacher.actor.encoder
    head.load_state_dict(teacher.actor.head.state_dict())
    take_in_units(head[0].weight, head[0].bias, Units.of(theirs), Units.of(mine))
