"""Algorithm 1: iterative domain alignment for policy transfer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from idapt_pl.evaluation.evaluation import Evaluation
from idapt_pl.image_diagnosis import DiscoverySettings
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.rl.policy import Policy
from idapt_pl.run_folder.results import REPAIRED
from idapt_pl.stages.aside import Aside, in_turn
from idapt_pl.stages.collection import explorer, on_policy, record_source, record_target, replay_in_source
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.convergence import check_convergence
from idapt_pl.stages.cut_episodes import as_cut, cut_horizon, cut_where_lost
from idapt_pl.stages.dynamics import fit_F
from idapt_pl.stages.encoder import fit_encoder, poses_through
from idapt_pl.stages.episode_lengths import warn_if_ended_sooner
from idapt_pl.stages.labels import labelled_images
from idapt_pl.stages.moved_poses import moved_poses
from idapt_pl.stages.policy import fit_grounded_policy, fit_source_policy
from idapt_pl.stages.repair import SourceRepair
from idapt_pl.stages.rollback import Rollback
from idapt_pl.stages.schedule import Schedule, length_of
from idapt_pl.stages.state_predictor import fit_P_S
from idapt_pl.stages.visual import fit_G

NO_DISCOVERY = DiscoverySettings(discover=False)


@dataclass(frozen=True)
class Grounding:
    """What a grounding step leaves to the next one, by the paper's symbols.

    Attributes:
        D_S: trajectory files of the source, images and states, the newest last.
        D_T: trajectory files of the target, images alone.
        P_S: predicts states from source images.
        G: source images to target images, with P^T.
        F: target actions to source actions; None is the identity.
        pi: the policy.
        report: waits for the measurements of the step, and gives them.
    """

    D_S: tuple[Path, ...]
    D_T: tuple[Path, ...]
    P_S: StatePredictor
    G: VisualTransformation
    F: ActionTransformation | None
    pi: AsymmetricSAC
    report: Callable[[], dict]


@dataclass(frozen=True)
class Sight:
    """What step 0 sees the target with, and what it learned that from.

    Attributes:
        D_S: of the source, as of :class:`Grounding`.
        D_T: of the target.
        G: source images to target images.
        pi: its encoder reads target images.
        labelled: target-like images with states; none where nothing learns from them.
        poses: target-like images, with states, of poses that no motion brings about.
    """

    D_S: tuple[Path, ...]
    D_T: tuple[Path, ...]
    G: VisualTransformation
    pi: AsymmetricSAC
    labelled: Sequence[Path]
    poses: Sequence[Path]


class IterativeGrounding:
    """IDAPT. Input: datasets D^S, D^T; output: a policy for the target and the grounding it learned in.

    The order is that of the authors' code, in which every F that is learned is used: the policy trains
    at the end of a grounding step, not at its beginning.

    Args:
        context: what all stages of the run share.
        evaluation: measures every step; nothing here depends on what it finds.
        schedule: what is done, and for how long.
        effects: whether effects are sought that the source lacks.
        aside: starts what the rest does not wait for: the source policy beside G, measurements beside the next step.
        randomised: whether policies train in variants of the source within the intervals of the effects that are found.
    """

    def __init__(
        self,
        context: StageContext,
        evaluation: Evaluation,
        schedule: Schedule,
        effects: DiscoverySettings = NO_DISCOVERY,
        aside: Aside = in_turn,
        randomised: bool = False,
    ) -> None:
        self.aside = aside
        self.context, self.evaluation, self.schedule = context, evaluation, schedule
        self.repair = SourceRepair(context, effects, self.record_control, randomised, schedule.paired_steps)
        self.rollback = Rollback(context.worlds, context.stages, schedule.rollback)

    def run(self) -> list[dict]:
        """Run Algorithm 1, or what is left of it. Returns what was measured after every step (``evaluation.json``)."""
        c, done = self.context, [self.begin()]
        for k in range(1, length_of(self.schedule.grounding_steps) + 1):
            new = record_target(c, k, on_policy(c, done[-1].pi), self.schedule.interactions)
            D_T = (*done[-1].D_T, new)
            if self.settled(k, done[-1], D_T):
                break
            done.append(self.step(k, done[-1], D_T))
        return [grounding.report() for grounding in done]

    def begin(self) -> Grounding:
        """Step 0: task-agnostic data, the source policy, G, and a policy that sees through G."""
        c, lengths = self.context, self.schedule.pretrain
        D_T: tuple[Path, ...] = (self.explore_target(),)
        self.repair.visual_effects(D_T[0])
        D_S: tuple[Path, ...] = (self.explore_source(),)
        moved = moved_poses(c, 0, D_S)
        P_S = fit_P_S(c, 0, (*D_S, *moved), lengths.state_predictor)
        source_policy = self.source_policy(P_S, D_S)
        seen = self.see(D_S, D_T, P_S, source_policy, moved)
        pi = fit_grounded_policy(c, 0, lengths, seen.G, None, seen.pi, seen.labelled, seen.poses)
        report = self.report(0, seen.D_T, P_S, seen.G, None, pi)
        return Grounding(seen.D_S, seen.D_T, P_S, seen.G, None, pi, report)

    def see(
        self, D_S: tuple[Path, ...], D_T: tuple[Path, ...], P_S: StatePredictor,
        source_policy: Callable[[], AsymmetricSAC], moved: Sequence[Path],
    ) -> Sight:  # fmt: skip
        """Step 0 up to what reads the target's images; again from recordings cut where physics loses them."""
        c, lengths = self.context, self.schedule.pretrain
        D_S, D_T = as_cut(c, D_S), as_cut(c, D_T)
        bare = c.worlds.source_domain, c.worlds.distribution
        G = fit_G(c, 0, D_S, D_T, lengths.visual, P_S, replayed=self.play_again(0, D_T))
        poses, prefix = poses_through(c, 0, moved, G), ""
        pi = fit_encoder(c, 0, D_S, lengths.estimator, G, source_policy(), poses)
        explored = D_S
        if self.repair.physical_effects(0, D_T, G, pi) and self.schedule.repaired_visual:
            # poses go together in the repaired source as in the target, where G had made up for what was missing
            explored, prefix = (self.explore_source(f"{REPAIRED}source"),), REPAIRED
            replayed = self.play_again(0, D_T, prefix=REPAIRED)
            G = fit_G(c, 0, explored, D_T, self.schedule.repaired_visual, P_S, G, replayed, f"{REPAIRED}visual")
            poses = poses_through(c, 0, moved, G, REPAIRED)
            pi = fit_encoder(c, 0, explored, lengths.estimator, G, pi, poses, REPAIRED)
        labelled = labelled_images(c, 0, explored, D_T, G, None, pi, self.schedule.paired_steps, prefix)
        if not cut_where_lost(c):
            return Sight(explored, D_T, G, pi, labelled, poses)
        c.worlds.source_domain, c.worlds.distribution = bare  # what was found then was read through a G that failed
        return self.see(D_S, D_T, P_S, source_policy, moved)

    def step(self, k: int, g: Grounding, D_T: tuple[Path, ...]) -> Grounding:
        """Grounding step k, on new data of the policy: G and F finetuned, the policy trained in their world."""
        c, lengths = self.context, self.schedule.finetune
        D_S = (*g.D_S, record_source(c, k, on_policy(c, g.pi), self.schedule.interactions, g.G, g.F))
        warn_if_ended_sooner(c, k, D_S[-1], D_T[-1])
        moved = moved_poses(c, k, self.recent(D_S))
        P_S = fit_P_S(c, k, (*self.recent(D_S), *moved), lengths.state_predictor, g.P_S)
        replayed = self.play_again(k, self.recent(D_T), g)
        G = fit_G(c, k, self.recent(D_S), self.recent(D_T), lengths.visual, P_S, g.G, replayed)
        poses = poses_through(c, k, moved, G)
        pi = fit_encoder(c, k, self.recent(D_S), lengths.estimator, G, g.pi, poses)
        repaired = self.repair.physical_effects(k, D_T, G, pi)
        F_before = None if repaired else g.F  # a source that was repaired needs a new F
        F = self.ground_actions(k, D_T, G, F_before, pi)
        F = self.rollback(k, D_T[-1], G, F, F_before, g.pi)
        labelled = labelled_images(c, k, self.recent(D_S), D_T, G, F, pi, self.schedule.paired_steps)
        pi_before, pi = pi, fit_grounded_policy(c, k, lengths, G, F, pi, labelled, poses)
        return Grounding(D_S, D_T, P_S, G, F, pi, self.report(k, D_T, P_S, G, F, pi, pi_before))

    def settled(self, k: int, g: Grounding, D_T: tuple[Path, ...]) -> bool:
        """Whether the policy's new data show nothing that step k could learn, if the schedule asks."""
        return self.schedule.until_settled and check_convergence(self.context, k, g.pi, g.G, g.F, D_T).settled

    def source_policy(self, P_S: StatePredictor, D_S: tuple[Path, ...]) -> Callable[[], AsymmetricSAC]:
        """The policy of the plain source, and what it is worth in the target as it is (direct transfer)."""

        def work() -> AsymmetricSAC:
            s = self.schedule
            pi = fit_source_policy(self.context, length_of(s.source_policy), s.pretrain, P_S, D_S)
            self.evaluation.direct_transfer(pi)
            return pi

        return self.aside("source_policy", self.context.stages.folder(0) / "direct_transfer.json", work)

    def report(
        self, k: int, D_T: tuple[Path, ...], P_S: StatePredictor, G: VisualTransformation,
        F: ActionTransformation | None, pi: AsymmetricSAC, pi_before: AsymmetricSAC | None = None,
    ) -> Callable[[], dict]:  # fmt: skip
        """Everything measured after step k; nothing waits for it."""
        work = partial(self.evaluation.report, k, D_T[-1:], P_S, G, F, pi, pi_before)
        return self.aside(f"evaluation_{k}", self.context.stages.folder(k) / "evaluation.json", work)

    def ground_actions(
        self,
        k: int,
        D_T: tuple[Path, ...],
        G: VisualTransformation,
        F: ActionTransformation | None,
        pi: AsymmetricSAC,
    ) -> ActionTransformation | None:
        """F by GARAT on the newest target data, and on the task-agnostic ones if F explores."""
        if not self.schedule.action_transformation:
            return F
        target = [D_T[0], D_T[-1]] if self.context.batches.garat_exploring else D_T[-1:]
        rollouts, hold_out = self.schedule.finetune.dynamics, self.schedule.rollback
        return fit_F(self.context, k, target, G, F, pi, rollouts, self.explore, hold_out)

    def explore_target(self) -> Path:
        """D^T: images of the target, from exploration."""
        self.explore(0)  # here, so that training who explores is a stage and not part of the recording
        return record_target(self.context, 0, self.explore, self.schedule.images, self.schedule.exploration_horizon)

    def explore_source(self, name: str = "source") -> Path:
        """D^S: images and states of the source as it is, from exploration."""
        s = self.schedule
        steps, horizon = s.source_images or s.images, cut_horizon(self.context) or s.exploration_horizon
        return record_source(self.context, 0, self.explore, steps, name=name, horizon=horizon)

    def play_again(self, k: int, D_T: tuple[Path, ...], g: Grounding | None = None, prefix: str = "") -> Path | None:
        """What the first actions of the target's episodes do in the source as it is: nearly the same, for a while."""
        if not (steps := self.schedule.paired_steps):
            return None
        G, F = (None, None) if g is None else (g.G, g.F)
        return replay_in_source(self.context, k, D_T, G, F, f"{prefix}replayed", steps)

    def record_control(self, k: int) -> Path:
        """New images and states of the source as it is, from exploration, that nothing is fitted to."""
        steps, horizon = self.schedule.images, cut_horizon(self.context) or self.schedule.exploration_horizon
        return record_source(self.context, k, self.explore, steps, name="control", horizon=horizon)

    def explore(self, seed: int, num_envs: int = 1) -> Policy:
        """The policy that collects D^S and D^T before there is one for the target."""
        s = self.schedule
        return explorer(self.context, s.exploration or "random", seed, num_envs, s.exploration_strays)

    def recent(self, data: tuple[Path, ...]) -> tuple[Path, ...]:
        """The data that a grounding step trains P^S and G on."""
        return data if self.schedule.accumulate else data[-1:]
