"""Correspondences (CC; Zhang et al. 2021): the source's policy is kept, and what the target shows is translated for it.

CC-State: a policy on states acts on what P^T reads of the target's images. CC-Image: a policy on images acts on the
target's images as the backward generator shows them. Both are of the source and learn nothing of the target's physics.
As in the paper the correspondence is learned from unpaired task-agnostic data and then from the policy's own, step by
step. The mapping of actions that CC learns besides is left out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from idapt_pl.envs import GroundedEnv, ImageEnv, SeenThrough
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.modules import SAC, StatePredictor, StateSAC, VisualTransformation
from idapt_pl.rl.experts import train_expert
from idapt_pl.rl.exploration import ExpertAtTheControls
from idapt_pl.rl.policy import deterministic
from idapt_pl.rl.returns import evaluate
from idapt_pl.run_folder.kept_outcomes import KeptOutcomes
from idapt_pl.stages.collection import on_policy, record_source, record_target
from idapt_pl.stages.policy import fit_source_policy
from idapt_pl.stages.schedule import length_of, policy_steps
from idapt_pl.stages.state_predictor import fit_P_S
from idapt_pl.stages.visual import fit_G

TRIED = 5
"""Episodes in the source behind G, seen through the correspondence."""


@dataclass(frozen=True)
class Correspondence(ABC):
    """A policy of the source that acts in the target through a learned correspondence.

    Attributes:
        grounding: the method, whose settings it has.
    """

    grounding: IterativeGrounding

    @abstractmethod
    def source_policy(self, P_S: StatePredictor, D_S: tuple[Path, ...]) -> SAC:
        """The policy of the source, which is never changed."""

    @abstractmethod
    def seen(self, env: ImageEnv, G: VisualTransformation) -> ImageEnv:
        """An environment that looks like the target, as the policy sees it."""

    @abstractmethod
    def act_in_source(self, k: int, pi: SAC) -> Path:
        """D^S of a grounding step: what the source shows of the policy."""

    def run(self) -> list[dict]:
        """Learn the correspondence, act in the target, learn from that, and so on. Returns what was measured."""
        g, c = self.grounding, self.grounding.context
        D_T: tuple[Path, ...] = (g.explore_target(),)
        D_S: tuple[Path, ...] = (g.explore_source(),)
        P_S = fit_P_S(c, 0, D_S, g.schedule.pretrain.state_predictor)
        pi = self.source_policy(P_S, D_S)
        G = fit_G(c, 0, D_S, D_T, g.schedule.pretrain.visual, P_S)
        measured = [self.measure(0, pi, G)]
        for k in range(1, length_of(g.schedule.grounding_steps) + 1):
            D_T, D_S = (*D_T, self.act_in_target(k, pi, G)), (*D_S, self.act_in_source(k, pi))
            lengths = g.schedule.finetune
            P_S = fit_P_S(c, k, g.recent(D_S), lengths.state_predictor, P_S)
            G = fit_G(c, k, g.recent(D_S), g.recent(D_T), lengths.visual, P_S, G)
            measured.append(self.measure(k, pi, G))
        return measured

    def act_in_target(self, k: int, pi: SAC, G: VisualTransformation) -> Path:
        """D^T of a grounding step: the target's images, while the policy acts on what is made of them."""
        c, steps = self.grounding.context, self.grounding.schedule.interactions
        return record_target(c, k, on_policy(c, pi), steps, seen=lambda env: self.seen(env, G))

    def measure(self, k: int, pi: SAC, G: VisualTransformation) -> dict:
        """The policy's return in the target, and in the source where that is shown as the target and seen back."""
        worlds, evaluation = self.grounding.context.worlds, self.grounding.evaluation

        def make(seed: int, kept: KeptOutcomes) -> dict:
            target = {}
            if worlds.target.measured:
                env = self.seen(worlds.rewarded_target(min(evaluation.episodes, 25)), G)
                target = evaluation.play_target(env, deterministic(pi), seed, kept)
            with closing(self.seen(worlds.grounded(TRIED, G), G)) as env:
                there = evaluate(env, deterministic(pi), TRIED, seed)
            return {"target": target, "grounded": {"mean": there.mean, "std": there.std}, "translation": {}}

        return evaluation.measured(k, make)


@dataclass(frozen=True)
class ImageCorrespondence(Correspondence):
    """CC-Image: the policy sees target images as the backward generator shows them."""

    def source_policy(self, P_S: StatePredictor, D_S: tuple[Path, ...]) -> SAC:
        c, schedule = self.grounding.context, self.grounding.schedule
        pi = fit_source_policy(c, policy_steps(schedule), schedule.pretrain, P_S, D_S)
        self.grounding.evaluation.direct_transfer(pi)
        return pi

    def seen(self, env: ImageEnv, G: VisualTransformation) -> ImageEnv:
        def back(pixels: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return G.translate_stacks(torch.from_numpy(pixels).to(G.device), back=True).cpu().numpy()

        return GroundedEnv(env, G=back, frames=G.frames)

    def act_in_source(self, k: int, pi: SAC) -> Path:
        c, steps = self.grounding.context, self.grounding.schedule.interactions
        return record_source(c, k, on_policy(c, pi), steps)


@dataclass(frozen=True)
class StateCorrespondence(Correspondence):
    """CC-State: the policy sees the states that P^T reads of target images."""

    def source_policy(self, P_S: StatePredictor, D_S: tuple[Path, ...]) -> SAC:
        c = self.grounding.context
        return train_expert(c.worlds.task, c.worlds.source_domain, c.worlds.task.expert, c.stages, "source_teacher")

    def seen(self, env: ImageEnv, G: VisualTransformation) -> ImageEnv:
        def read(pixels: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return G.estimator.predict(torch.from_numpy(pixels).to(G.device)).float().cpu().numpy()

        return SeenThrough(env, read)

    def act_in_source(self, k: int, pi: SAC) -> Path:
        assert isinstance(pi, StateSAC)  # as source_policy made it
        c, steps = self.grounding.context, self.grounding.schedule.interactions
        return record_source(c, k, lambda seed: ExpertAtTheControls(pi, "expert"), steps)
