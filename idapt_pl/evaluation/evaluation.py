"""What a run reports: returns in the target, residuals, translation errors. Nothing here trains or selects."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from idapt_pl.envs import ImageEnv, TargetFailed
from idapt_pl.evaluation.estimates import EstimateErrors
from idapt_pl.evaluation.paired import paired_errors
from idapt_pl.evaluation.video import log_scalars, log_video, record_video, side_by_side
from idapt_pl.files import blaming, write_json
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.rl.policy import Policy, deterministic, warn_if_lost
from idapt_pl.rl.returns import EpisodeOutcome, Watch, evaluate
from idapt_pl.rl.transition_distance import transition_residual
from idapt_pl.run_folder.interactions import DIRECT_TRANSFER, VIDEO, VIDEO_STEPS, evaluation_interactions
from idapt_pl.run_folder.kept_config import shortened_by
from idapt_pl.run_folder.kept_outcomes import KeptOutcomes
from idapt_pl.run_folder.results import effect_files
from idapt_pl.stage import Stages
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)


class Evaluation:
    """Measures after each grounding step and writes ``RUN/step_<k>/evaluation.json`` and ``summary.json``.

    Args:
        worlds: of the run.
        stages: of the run.
        episodes: episodes for each return.
        target_name: for the summary.
        method: for the summary.
    """

    def __init__(self, worlds: Worlds, stages: Stages, episodes: int, target_name: str, method: str = "idapt") -> None:
        self.worlds, self.stages, self.episodes = worlds, stages, episodes
        self.target_name, self.method = target_name, method

    def target_return(self, policy: AsymmetricSAC, seed: int, kept: KeptOutcomes | None = None) -> dict:
        """Return (or success) of a policy in the target, acting with its mean, and how wrong it is about the state.

        Empty where the target is not to be measured.

        Args:
            policy: acts.
            seed: of the episodes' starts.
            kept: where the outcomes of a target that cannot be played again are kept meanwhile.

        Raises:
            TargetFailed: if the target fails.
        """
        target = self.worlds.target
        if not target.measured:
            return {}
        act = deterministic(policy)
        errors = EstimateErrors(act)
        env = self.worlds.rewarded_target(min(self.episodes, 25))
        result = self.play_target(env, act, seed, kept, errors if target.has_states else None)
        return result | {"state_errors": errors.to_dict()}

    def play_target(
        self, env: ImageEnv, act: Policy, seed: int, kept: KeptOutcomes | None, watch: Watch | None = None
    ) -> dict:
        """Outcomes of whole episodes in the target as somebody sees it; closes it.

        Args:
            env: the target with its reward.
            act: acts.
            seed: of the episodes' starts.
            kept: where the outcomes of a target that cannot be played again are kept meanwhile.
            watch: sees what the policy saw.

        Raises:
            TargetFailed: if the target fails.
        """
        before: list[EpisodeOutcome] = []
        keep = None
        if kept is not None and not self.worlds.target.repeatable:
            before = [EpisodeOutcome(**outcome) for outcome in kept]
            keep = lambda outcome: kept.add(asdict(outcome))  # noqa: E731
        with closing(env):
            return evaluate(env, act, self.episodes, seed, watch, before, keep).to_dict()

    def keeping(self, step: int, name: str, purpose: str, make: Callable[[int, KeptOutcomes], dict]) -> dict:
        """A measurement of a grounding step; if the target fails, episodes that are over are kept and counted."""
        kept = KeptOutcomes(self.stages.folder(step), name)
        try:
            result = self.stages.measure(step, name, lambda seed: make(seed, kept))
        except TargetFailed as failure:
            self.worlds.ledger.enter(step, purpose, kept.steps)
            whole = sum(outcome["whole"] for outcome in kept)
            raise TargetFailed(
                f"{failure}. {whole} of {self.episodes} episodes of {name.replace('_', ' ')}, step {step}, are kept; "
                "when the target works again, the same command goes on"
            ) from failure
        kept.forget()
        return result

    def measured(self, step: int, make: Callable[[int, KeptOutcomes], dict]) -> dict:
        """What a baseline measures after a step, as ``evaluation.json`` and on the ledger."""
        result = self.keeping(step, "evaluation", "evaluation", make)
        if there := result["target"]:
            log.info("step %d  target return %.1f ± %.1f", step, there["mean"], there["std"])
        self.worlds.ledger.enter(step, "evaluation", evaluation_interactions(self.stages.folder(step), result))
        return result

    def direct_transfer(self, policy: AsymmetricSAC) -> dict:
        """The source policy, as it is, in the target."""

        def make(seed: int, kept: KeptOutcomes) -> dict:
            return self.target_return(policy, seed, kept) or {"interactions": 0}

        result = self.keeping(0, "direct_transfer", DIRECT_TRANSFER, make)
        with blaming(self.stages.folder(0) / "direct_transfer.json"):
            if "mean" in result:
                log.info("step 0  direct transfer: %.1f ± %.1f in the target", result["mean"], result["std"])
            interactions = result["interactions"]
        self.worlds.ledger.enter(0, DIRECT_TRANSFER, interactions)
        return result

    def report(
        self,
        step: int,
        target: Sequence[Path],
        P_S: StatePredictor,
        G: VisualTransformation,
        F: ActionTransformation | None,
        policy: AsymmetricSAC,
        policy_before: AsymmetricSAC | None = None,
    ) -> dict:
        """Everything measured after one grounding step."""

        def make(seed: int, kept: KeptOutcomes) -> dict:
            with closing(self.worlds.grounded(5, G, F)) as env:
                act = deterministic(policy)
                errors = EstimateErrors(act)
                grounded = evaluate(env, act, 5, seed, errors)
            result = {
                "target": self.target_return(policy, seed, kept),
                "grounded": {"mean": grounded.mean, "std": grounded.std, "state_errors": errors.to_dict()},
                "translation": paired_errors(self.worlds, policy, G, P_S, 200, seed),
            }
            if F is not None and policy_before is not None:
                result["residual"] = transition_residual(self.worlds, policy_before, G, F, target, seed)
            # before the file that counts its steps: a run killed in between makes both again
            result["video_interactions"] = self.show(step, result, policy, G, F)
            return result

        result = self.keeping(step, "evaluation", "evaluation", make)
        folder = self.stages.folder(step)
        with blaming(folder / "evaluation.json"):
            lost = result["target"].get("state_errors", {}).get("lost")
            warn_if_lost(lost, f"step {step}, acting in the target")
            there = result["target"]
            told = f"target return {there['mean']:.1f} ± {there['std']:.1f}" if there else "target not measured"
            log.info(
                "step %d  %s, grounded %.1f; residual %s; translation %s",
                step,
                told,
                result["grounded"]["mean"],
                result.get("residual", "-"),
                result["translation"] or "-",
            )
            interactions = evaluation_interactions(folder, result)
        self.worlds.ledger.enter(step, "evaluation", interactions)
        return result

    def show(
        self, step: int, result: dict, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None
    ) -> int:
        """The run's TensorBoard page: returns, residuals, and the policy in grounded source and target.

        Returns:
            Control steps in the target that the video shows.
        """
        folder = self.stages.folder(step)
        scalars = {"returns/grounded": result["grounded"]["mean"]}
        if there := result["target"]:
            scalars["returns/target"] = there["mean"]
        if result["translation"]:
            scalars["translation/psnr"] = result["translation"]["psnr"]
        if "lost" in (errors := there.get("state_errors", {})):
            scalars["state/lost"] = errors["lost"]
        scalars |= {f"residual/{k}": v for k, v in result.get("residual", {}).items()}
        log_scalars(folder, scalars, step)
        videos, envs = [], list[ImageEnv]([self.worlds.grounded(1, G, F)])
        if self.worlds.target.measured:
            envs.append(self.worlds.rewarded_target(1, asking=False))
        for env in envs:
            with closing(env):
                frames, taken = record_video(env, deterministic(policy), VIDEO_STEPS, seed=step)
                videos.append(frames)
        log_video(folder, VIDEO, side_by_side(*videos), step)
        return taken * (len(videos) - 1)

    def summary(self, evaluations: Sequence[dict]) -> dict:
        """Write and return ``summary.json``.

        Args:
            evaluations: of every step, from step 0 on, as in ``evaluation.json``.

        Raises:
            DamagedFile: if a result that it is made of is damaged.
        """
        read = self.stages.read

        def read_if_there(step: int, name: str) -> dict | None:
            return read(step, name) if (self.stages.folder(step) / f"{name}.json").exists() else None

        steps = max(0, len(evaluations) - 1)
        settled = (read_if_there(steps + 1, "convergence") or {}).get("settled", False)
        target = [e["target"].get("mean") for e in evaluations]
        selections = {k: read_if_there(k, "selection") for k in range(1, steps + 1)}
        oracle = read_if_there(0, "oracle_evaluation")
        found = [(k, read(k, path.stem)) for k in range(steps + 1) for path in effect_files(self.stages.folder(k))]
        stages = self.stages.timings()
        direct = (read_if_there(0, "direct_transfer") or {}).get("mean")
        last = {"source": direct, "oracle": oracle and oracle["mean"]}.get(self.method, (target or [None])[-1])
        summary = {
            "task": self.worlds.task.name,
            "target": self.target_name,
            "seed": self.stages.seed,
            "method": self.method,
            "shortened_by": shortened_by(self.stages.run_dir),
            "metric": self.worlds.task.metric,
            "episodes": self.episodes,
            "result": last,
            "direct_transfer": direct,
            "oracle": oracle["mean"] if oracle else None,
            "visual_only": target[0] if target else None,
            "grounded": target[1:] + target[-1:] * settled,  # the policy stays
            "settled": steps + 1 if settled else None,
            "effects": [{"step": k} | e for k, result in found for e in result["effects"]],
            "rolled_back": [k for k, s in selections.items() if s and s["rolled_back"]],
            "target_interactions": self.worlds.ledger.training_total,
            "wall_s": round(self.stages.elapsed(), 1),
            "stages": stages,
        }
        write_json(self.stages.run_dir / "summary.json", summary)
        return summary
