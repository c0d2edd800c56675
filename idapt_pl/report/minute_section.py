"""The first section of a diagnosis' page: question and answer, for who has a minute."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from idapt_pl.diagnosis.answer.result import DiagnosisResult, Verdict
from idapt_pl.effects.wording import format_estimate, format_number, phrase_at
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.report.diagnosis_wording import (
    nominal_in_words,
    quick_and_unexplained,
    rest_explained_by,
    size_in_words,
    without_negligible_laws,
)
from idapt_pl.report.explanation_section import not_named_sentences, probability_sentences
from idapt_pl.report.html import row, section, table

MOST_NAMED = 3
"""Effects that the first section names."""

ANSWERS = {
    Verdict.EFFECTS_FOUND: "No, but it can be repaired: see below.",
    Verdict.NO_MISSING_EFFECT: "Yes, as far as these recordings show.",
    Verdict.UNEXPLAINED_RESIDUAL: "No, and it is not known in full why.",
    Verdict.INSUFFICIENT_EXCITATION: "These recordings cannot tell.",
}
REST_EXPLAINED = {
    "law": (
        "No, but a law of force that was learned repairs it: see below.",
        "Simulate with effects.yaml, which has the law as patched.xml cannot, and look for its cause where it acts.",
    ),
    "change": (
        "No: what it lacks changes while the machine is recorded.",
        "Find out why it changes (Does it change while it is recorded?). No one value is right for all recordings: "
        "diagnose those of each state alone, or keep the state the same.",
    ),
}
"""Answer and action where a law, or a change, explains what known effects that stay the same do not."""

AFTER_A_QUICK_LOOK = "Run the whole diagnosis, without --quick."
ACTIONS = {
    Verdict.EFFECTS_FOUND: "Check the values on the machine (What to do next), then use patched.xml in place of the "
    "model.",
    Verdict.NO_MISSING_EFFECT: "Nothing: keep the model.",
    Verdict.UNEXPLAINED_RESIDUAL: "Do not rely on the model yet: record what is asked for under What to do next, or "
    "look at the machine where the residual is largest.",
    Verdict.INSUFFICIENT_EXCITATION: "Record larger and more varied motion, and diagnose again.",
}


def minute_section(result: DiagnosisResult, sim: Simulator, warnings: Sequence[str]) -> str:
    """Five questions and their answers.

    Args:
        result: of the diagnosis.
        sim: with the recordings.
        warnings: what else is known of the recordings, a few words each.
    """
    rest = rest_explained_by(result)
    answer, action = REST_EXPLAINED[rest] if rest else (ANSWERS[result.verdict], ACTIONS[result.verdict])
    if quick_and_unexplained(result):
        action = AFTER_A_QUICK_LOOK
    if result.mending:
        action = f"First take the deployment faults out: {result.mending}"
    rows = [
        ("Does the model move like the machine?", answer),
        ("What is different?", differences_in_words(result, sim.model)),
        ("How much does that matter?", matter_in_words(result)),
        ("How sure is it?", sureness_in_words(result, sim)),
        ("What to do now?", action),
    ]
    if result.not_tried:
        rows.append(("What was not tried?", f"This was a quick look, without {', '.join(result.not_tried)}."))
    if warnings:
        rows.append(("What to know of the recordings?", " ".join(warnings)))
    return section("In a minute", table(("", ""), (row(*r) for r in rows)))


def differences_in_words(result: DiagnosisResult, model: mujoco.MjModel) -> str:
    """The effects found, shortly; without laws that are too weak to matter."""
    result = without_negligible_laws(result)
    if not result.effects:
        nothing = {Verdict.NO_MISSING_EFFECT: "Nothing that was found."}
        return nothing.get(result.verdict, "Not known.")
    told = []
    for e in result.effects[:MOST_NAMED]:
        name, p = next(iter(e.parameters.items()))
        several = f" {name}" if len(e.parameters) > 1 else ""
        value = format_estimate(p.estimate, p.ci95)[0]
        amount = f"{several}: {value} instead of {nominal_in_words(p)}"
        told.append(f"{phrase_at(*e.key)}{size_in_words(result.laws, e) or amount}")
    more = len(result.effects) - MOST_NAMED
    return "; ".join(told) + (f"; and {more} more" if more > 0 else "") + "."


def matter_in_words(result: DiagnosisResult) -> str:
    """The errors before and after, in times of what is unavoidable."""
    before, after = (format_number(x, 2) for x in (result.error.before, result.error.after))
    over, unit = (
        f"predictions over {format_number(result.error.horizon_s)} s",
        "what the sensors' noise alone would make",
    )
    if result.error.unexplained:
        over, unit = "the force that acts", result.error.yardstick
    if not result.effects:
        return f"Errors of {over} are {after} times {unit}."
    return f"Errors of {over} were {before} times {unit}; repaired, {after} times."


def sureness_in_words(result: DiagnosisResult, sim: Simulator) -> str:
    """On what it was judged, and what it could also be."""
    seconds = format_number(sum(float(r.time[-1] - r.time[0]) for r in sim.data), 2)
    judged, n = len(result.error.held_out_episodes), len(sim.data)
    told = f"Judged on {judged} of {n} episodes ({seconds} s in all) that nothing was fitted to."
    sentences = [*probability_sentences(result.explanations, result.error), *not_named_sentences(result)]
    told += "".join(f" {sentence}" for sentence in sentences)
    unsure = [phrase_at(*e.key) for e in result.effects if e.equivalent]
    if unsure:
        told += f" Not decided: {'; '.join(unsure[:MOST_NAMED])} could also be something else (Effects to add)."
    return told
