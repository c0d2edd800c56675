"""What happened in a run, in words and numbers."""

from __future__ import annotations

from idapt_pl.effects.wording import format_number
from idapt_pl.report.run_record import RunRecord, StepRecord
from idapt_pl.stages.convergence import Convergence
from idapt_pl.stages.rollback import RollbackDecision


def format_score(value: float, metric: str) -> str:
    """A return, or a share of successes."""
    return f"{100 * value:.0f} %" if metric == "success" else f"{value:.0f}" if abs(value) >= 100 else f"{value:.1f}"


def format_result(result: dict, metric: str) -> str:
    """Mean and spread; the spread of successes says nothing that their share does not."""
    mean = format_score(result["mean"], metric)
    return mean if metric == "success" else f"{mean} ± {format_score(result['std'], metric)}"


def step_name(step: StepRecord) -> str:
    """What a step's policy is called."""
    if step.k:
        return f"Grounding step {step.k}"
    return f"Visual grounding{', source repaired' if step.source_repaired else ' only'}"


def format_distance(residual: dict, key: str) -> str:
    """An energy distance and, where it was measured on several rollouts, their standard deviation."""
    std = residual.get(f"{key}_std")
    return format_number(residual[key]) + (f" ± {format_number(std)}" if std is not None else "")


def step_story(record: RunRecord, step: StepRecord, metric: str) -> list[str]:
    """What happened in a step, in sentences."""
    away = [f"Training ran away, look at its curves. Stage {words}." for words in step.ran_away]
    sentences = []
    if step.convergence:
        sentences.append(Convergence.from_dict(step.convergence).sentence.capitalize() + ".")
    if step.settled:
        return [*sentences, "So the run ended here, and the policy of the step before stays."]
    if not step.evaluation:
        stages = ", ".join(step.seconds) or "nothing"
        return [*sentences, f"This step did not end: there is no evaluation. Finished in it: {stages}.", *away]
    before = [record.direct_transfer, *(s.evaluation["target"] for s in record.evaluated if s.k < step.k)][-1]
    there = step.evaluation["target"]
    now = f"{metric.capitalize()} in the target: {format_result(there, metric) if there else 'not measured'}"
    now += f", {format_score(before['mean'], metric)} before" if before else ""
    place = len(sentences)
    sentences.append(f"{now}; in the grounded source: {format_score(step.evaluation['grounded']['mean'], metric)}.")
    if residual := step.evaluation.get("residual"):
        which = "the F that was gone back to" if step.selection.get("rolled_back") else "F"
        sentences.append(
            f"With {which}, the grounded source moves {format_distance(residual, 'after')} away from the target, "
            f"without it {format_distance(residual, 'before')}; two halves of the target's own data are "
            f"{format_number(residual['noise_floor'])} apart (energy distance of transitions, ± the standard "
            "deviation over rollouts)."
        )
    if translation := step.evaluation["translation"]:
        psnr = format_number(translation["psnr"])
        sentences[place] += f" What G draws is {psnr} dB (PSNR) from the target's image of the same state."
    if (attempts := step.training.get("attempts", 1)) > 1:
        sentences.append(
            f"The policy trained {attempts} times, as it fell short of what the source's policy does in the source; it "
            f"ended with {format_score(step.training['trial_kept'], metric)} in the grounded source."
        )
    if step.training.get("kept") == "before":
        before, after = (format_score(step.training[f"trial_{k}"], metric) for k in ("before", "after"))
        sentences.append(
            f"Training made the policy worse in the grounded source ({metric} {before} before, {after} after): it was "
            "put back."
        )
    if step.labels:
        sentences.append(
            "The target's own images got states by physics, for which their readings were taken to be "
            f"{format_number(step.labels['factor'])} times as wrong as those of source images that G shows."
        )
    if step.selection:
        sentences.append(RollbackDecision.from_dict(step.selection).sentence + ".")
    return sentences + away
