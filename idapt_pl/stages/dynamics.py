"""The stage of F: GARAT on transitions of the target and of the grounded source (Section IV-C2).

Here a target frame becomes F's reward: :func:`~datamodules.on_policy.target_transitions` turns frames into features,
F's discriminator tells them from the grounded source's, and :func:`~idapt_pl.losses.gail_reward` is what F is paid.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from datamodules import OnPolicyDataModule
from datamodules.on_policy import encode_all, target_transitions
from datamodules.pieces import held_out, pieces
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.nets.devices import on_device
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.nets.units import Units
from idapt_pl.rl.grounded_rollout import garat_rollout
from idapt_pl.rl.policy import Acting, Policy
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.trajectory_matching import initialise_by_matching

log = logging.getLogger(__name__)


def fit_F(
    c: StageContext,
    step: int,
    target: Sequence[Path],
    G: VisualTransformation,
    initial: ActionTransformation | None,
    pi: AsymmetricSAC,
    rollouts: int,
    explore: Callable[[int, int], Policy],
    hold_out: bool = False,
) -> ActionTransformation:
    """F with GARAT: grounded rollouts of π (and of ``explore``) against the target's transitions.

    Args:
        c: of the run.
        step: grounding step.
        target: trajectory files; images and actions are all that is used.
        G: shows source images as target images.
        initial: the F that this one goes on from.
        pi: whose features F sees, and whose rollouts it corrects.
        rollouts: of GARAT.
        explore: seed and number of simulations to the policy of the task-agnostic data.
        hold_out: keep a share of the newest target file away from F, for :mod:`~idapt_pl.stages.rollback`.
    """

    def build() -> ActionTransformation:
        module = c.make.dynamics(encoder=copy.deepcopy(pi.actor.encoder), **c.worlds.action_bounds)
        if initial is not None:  # F continues, on the newest features
            kept = {k: v for k, v in initial.state_dict().items() if not k.startswith("encoder.")}
            module.load_state_dict(kept, strict=False)
            if isinstance(module.encoder, PixelStatePredictor) and isinstance(initial.encoder, PixelStatePredictor):
                module.tell_features_in_units(Units.of(initial.encoder), Units.of(module.encoder))
        return module

    def feed(F: ActionTransformation, seed: int, device: torch.device) -> OnPolicyDataModule:
        n = c.batches.garat_envs
        env = c.worlds.grounded(n, on_device(G, device))
        policy = Acting(on_device(pi, device), c.worlds.target.mean_actions)  # as where it was recorded
        length, exploring = c.batches.garat_rollout // n, round(c.batches.garat_exploring * n)
        roll = garat_rollout(env, policy, F, length, seed, explore(seed, n), exploring)
        transitions = target_transitions(target, F.encode, c.worlds.frame_stack, hold_out)
        if initial is None and c.batches.garat_start == "matching":
            F.standardise(transitions)
            start_by_matching(c, F.cpu(), target, hold_out)
            F.to(device)
        return OnPolicyDataModule(roll, transitions, rollouts)

    return c.stages.fit(step, "dynamics", build, feed, rollouts)


def start_by_matching(c: StageContext, F: ActionTransformation, target: Sequence[Path], hold_out: bool) -> None:
    """Give F a start by trajectory matching, without what is held out of the newest file.

    Raises:
        ValueError: if F's features are no states.
    """
    if not isinstance(F.encoder, PixelStatePredictor):
        raise ValueError(
            "feeding.garat_start: matching needs features that are states, i.e. policy.encoder: supervised; "
            "with a learned encoder use garat_start: identity"
        )
    seen = seen_states(c, F, target, hold_out)
    left = initialise_by_matching(F, c.worlds.task, c.worlds.source_domain, *seen, c.batches.garat_ridge)
    weights = F.affine.weight.detach().flatten().numpy().round(3).tolist()
    log.info("F by trajectory matching: %s; left %.3g", weights, left)


def seen_states(
    c: StageContext, F: ActionTransformation, target: Sequence[Path], hold_out: bool = False
) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """What F's features say of the target's recordings, where they are states.

    Returns:
        States in units (N, state_dim), actions (N, nu), and the number of the stretch that each is of, (N,). With
        ``hold_out``, without what is held out of the newest file.
    """
    data, f = FrameStacks(read_all(target), c.worlds.frame_stack), F.encoder
    states = (encode_all(data, F.encode) * f.std + f.mean).detach()
    actions = torch.zeros(len(data), data.actions.shape[1])
    actions[data.transitions] = torch.from_numpy(data.actions)
    stretch, kept = data.first, np.ones(len(data), bool)
    if hold_out:
        piece = pieces(FrameStacks(read_all(target[-1:]), c.worlds.frame_stack))
        newest = np.arange(len(data)) >= len(data) - len(piece)
        stretch = np.concatenate([data.first[~newest], len(data) + piece])  # windows must not cross a gap
        kept[newest] = ~held_out(piece)
    return states[kept], actions[kept], stretch[kept]
