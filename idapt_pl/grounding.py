"""Algorithm 1: iterative domain alignment for policy transfer."""

from __future__ import annotations

import logging
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from idapt_pl.appearance.discovery import discover_visual_effects
from idapt_pl.effects import effect_from_dict
from idapt_pl.evaluation.evaluation import Evaluation
from idapt_pl.files import write_yaml
from idapt_pl.image_diagnosis import discover_effects
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.rl.collect import collect
from idapt_pl.rl.exploration import EXPLORATION
from idapt_pl.rl.policy import Policy
from idapt_pl.stages.fitting import Fitting
from idapt_pl.stages.rollback import compare_transformations, rollback_sentence

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Lengths:
    """How long the stages of one grounding step train.

    Args:
        state_predictor: batches for P^S.
        visual: batches for G and P^T.
        dynamics: GARAT rollouts for F.
        policy: environment steps for the policy.
        estimator: batches for the policy's encoder before the policy trains, regressed on the states of D^S as G shows
            it; for ``policy.encoder: supervised``. 0 leaves the encoder to the policy's own training.
    """

    state_predictor: int
    visual: int
    policy: int
    dynamics: int = 0
    estimator: int = 0


@dataclass(frozen=True)
class Schedule:
    """What Algorithm 1 does, and for how long.

    Args:
        grounding_steps: N.
        images: control steps in each of the task-agnostic datasets.
        source_images: control steps in the source's, where they are to be more: labelled images of the source cost no
            target interaction, and P^S and the policy's encoder overfit few. None for as many as ``images``.
        exploration: the policy that collects them, ``random`` (uniform actions), ``babble`` (slower and at several
            strengths) or ``rehearse`` (what the teacher does in the source, played without looking).
        interactions: control steps taken in the target in each grounding step.
        source_policy: environment steps in the plain source, for the policy everything starts from; it is
            also the reference for direct transfer.
        pretrain: stages before the first grounding step.
        finetune: stages of every grounding step.
        action_transformation: learn F; without it only the images are grounded (an ablation).
        accumulate: train P^S and G on all data so far; else on the newest alone.
        rollback: go on with the F of the step before where the new one makes the grounded source clearly less like the
            target, by a fifth of the target's images and actions that it was not fitted to. No reward of the target
            takes part.
    """

    grounding_steps: int = 5
    images: int = 20_000
    source_images: int | None = None
    exploration: Literal["random", "babble", "rehearse"] = "random"
    interactions: int = 1000
    source_policy: int = 10_000
    pretrain: Lengths = field(default_factory=lambda: Lengths(25_000, 100_000, 10_000))
    finetune: Lengths = field(default_factory=lambda: Lengths(625, 5000, 10_000, 10))
    action_transformation: bool = True
    accumulate: bool = False
    rollback: bool = False


NOTHING = DiscoverySettings(discover=False)


class IterativeGrounding:
    """IDAPT. Input: datasets D^S, D^T; output: a policy for the target and the grounding it learned in.

    The order is that of the authors' code, in which every F that is learned is used: the policy trains
    at the end of a grounding step, not at its beginning.
    """

    def __init__(
        self, fit: Fitting, evaluation: Evaluation, schedule: Schedule, effects: DiscoverySettings = NOTHING
    ) -> None:
        self.fit, self.evaluation, self.schedule, self.effects = fit, evaluation, schedule, effects
        self.worlds, self.stages = fit.worlds, fit.stages
        if schedule.exploration == "rehearse" and not fit.teacher.steps:
            raise ValueError(
                "schedule.exploration: rehearse plays what a teacher does in the source, and there is none: "
                "give teacher.steps and teacher.dagger, or explore by babble or random"
            )

    def run(self) -> dict:
        """Run Algorithm 1, or what is left of it. Returns the summary (see ``summary.json``)."""
        pretrain, finetune = self.schedule.pretrain, self.schedule.finetune

        D_T = [self.explore_target()]
        self.repair_looks(D_T[0])
        D_S = [self.explore_source()]
        P_S = self.fit.state_predictor(0, D_S, pretrain.state_predictor, None)
        pi = self.fit.source_policy(self.schedule.source_policy, P_S, D_S)
        self.evaluation.direct_transfer(pi)

        G = self.fit.visual(0, D_S, D_T, pretrain.visual, P_S, None)
        pi = self.fit.estimator(0, D_S, pretrain.estimator, G, pi)
        self.repair_source(0, D_T, G, pi)
        F = None  # the identity
        pi = self.fit.grounded_policy(0, pretrain.policy, G, F, pi)
        self.evaluation.report(0, pi, G, F, P_S, D_T[-1:])

        for k in range(1, self.schedule.grounding_steps + 1):
            pi_online = pi  # that D_T_k is of
            D_T.append(self.roll_out_target(k, pi))
            D_S.append(self.roll_out_grounded(k, pi, G, F))
            P_S = self.fit.state_predictor(k, self.recent(D_S), finetune.state_predictor, P_S)
            G = self.fit.visual(k, self.recent(D_S), self.recent(D_T), finetune.visual, P_S, G)
            pi = self.fit.estimator(k, self.recent(D_S), finetune.estimator, G, pi)
            if self.repair_source(k, D_T, G, pi):
                F = None  # it was F of another source
            F_before, pi_before = F, pi
            if self.schedule.action_transformation:
                hold_out = self.schedule.rollback
                F = self.fit.dynamics(k, self.for_dynamics(D_T), finetune.dynamics, pi, G, F, self.explore, hold_out)
                if self.makes_it_worse(k, pi_online, G, F, F_before, D_T[-1]):
                    F = F_before
            pi = self.fit.grounded_policy(k, finetune.policy, G, F, pi)
            self.evaluation.report(k, pi, G, F, P_S, D_T[-1:], pi_before)

        return self.evaluation.summary(self.schedule.grounding_steps)

    def explore_source(self) -> Path:
        """D^S: images and states of the source, from exploration."""
        return self._record_source(0, self.explore, None, None, self.schedule.source_images or self.schedule.images)

    def explore_target(self) -> Path:
        """D^T: images of the target, from exploration."""
        if self.schedule.exploration == "rehearse":
            self.fit.source_teacher()  # here, so that its training is a stage and not part of the recording
        return self._record_target(0, self.explore, self.schedule.images)

    def roll_out_target(self, k: int, pi) -> Path:
        """D^T_online: the current policy in the target."""
        return self._record_target(k, lambda seed: pi.act, self.schedule.interactions)

    def roll_out_grounded(self, k: int, pi, G, F) -> Path:
        """D^S_online: the current policy in the grounded source; source images and states are kept."""
        return self._record_source(k, lambda seed: pi.act, G, F, self.schedule.interactions)

    def repair_looks(self, D_T: Path) -> None:
        """Add to the source the visual effects that the first frames of the target's episodes show it lacks."""
        if not self.effects.looks:
            return

        def make(seed: int) -> dict:
            found = discover_visual_effects(self.worlds.task, self.worlds.source_domain, D_T, seed, self.worlds.view)
            return found.to_dict()

        self._repair(0, self.stages.measure(0, "looks", make)["effects"])

    def repair_source(self, k: int, D_T: list[Path], G, pi) -> bool:
        """Add to the source the effects that the target's images show it lacks. Returns whether there were any.

        Images are read by π's estimator. What it makes of new recordings of the source says how well.
        """
        if not self.effects.discover:
            return False
        worlds, target = self.worlds, D_T if k == 0 else [D_T[0], D_T[-1]]
        control = self._record_source(k, self.explore, None, None, self.schedule.images, "control")
        sensor = ImageSensor(pi.estimator(G), worlds.task, worlds.frame_stack)

        def make(seed: int) -> dict:
            found = discover_effects(
                worlds.source_domain, sensor, G, target, [control], self.effects, seed, worlds.seen
            )
            return found.to_dict()

        found = self.stages.measure(k, "effects", make)["effects"]
        self._repair(k, found)
        return bool(found)

    def makes_it_worse(self, k: int, pi, G, F, F_before, D_T: Path) -> bool:
        """Whether the target's images and actions that were held out of F say that it is clearly worse than before."""
        if not self.schedule.rollback:
            return False
        decision = self.stages.measure(
            k, "selection", lambda seed: compare_transformations(self.worlds, pi, G, F, F_before, D_T, seed)
        )
        log.info("step %d  %s", k, rollback_sentence(decision))
        return decision["rolled_back"]

    def explore(self, seed: int, num_envs: int = 1) -> Policy:
        """The policy that collects D^S and D^T before there is one for the target."""
        if self.schedule.exploration == "rehearse":
            return self.fit.rehearsal(seed, num_envs)
        with closing(self.worlds.source(num_envs)) as env:
            return EXPLORATION[self.schedule.exploration](env, seed)

    def recent(self, data: list[Path]) -> list[Path]:
        """The data that a grounding step trains P^S and G on."""
        return data if self.schedule.accumulate else data[-1:]

    def for_dynamics(self, data: list[Path]) -> list[Path]:
        """The target data for GARAT: under the current policy, and the task-agnostic data if F explores."""
        return [data[0], data[-1]] if self.fit.feeding.garat_exploring else data[-1:]

    def _repair(self, k: int, found: list[dict]) -> None:
        """Add effects to the source. The run folder keeps all so far, as a domain or ``idapt diagnose`` takes them."""
        self.worlds.repair(effect_from_dict(e) for e in found)
        for folder in (self.stages.folder(k), self.stages.run_dir):
            write_yaml(folder / "effects.yaml", [e.to_dict() for e in self.worlds.repairs])

    def _record_target(self, k: int, policy, steps: int) -> Path:
        def make(seed: int):
            with closing(self.worlds.blind_target(k)) as env:
                return collect(env, policy(seed), steps, seed, f"{self.worlds.task.name} target, step {k}")

        path, taken = self.stages.record(k, "target", make)
        self.worlds.ledger.enter(k, "training", taken)
        return path

    def _record_source(self, k: int, policy, G, F, steps: int, name: str = "source") -> Path:
        def make(seed: int):
            env = self.worlds.grounded(1, G, F)
            return collect(env, policy(seed), steps, seed, f"{self.worlds.task.name} source, step {k}", "source_pixels")

        return self.stages.record(k, name, make)[0]
