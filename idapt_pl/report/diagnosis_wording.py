"""A diagnosis in words: the verdict as sentences, numbers with their digits and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import mujoco
import numpy as np

from idapt_pl.diagnosis.answer.law_result import LawReport
from idapt_pl.diagnosis.answer.result import (
    ChannelError,
    DiagnosisResult,
    EffectEstimate,
    ErrorTable,
    ParameterEstimate,
    Verdict,
)
from idapt_pl.effects.base import EFFECTS
from idapt_pl.effects.learned import LearnedForce
from idapt_pl.effects.wording import format_estimate, format_number, listing, phrase_at, unit_at
from idapt_pl.report.law_section import law_size
from idapt_pl.report.limits_section import limit_sentence

HEADLINES = {
    Verdict.EFFECTS_FOUND: "Found what the model lacks",
    Verdict.NO_MISSING_EFFECT: "Nothing is missing",
    Verdict.UNEXPLAINED_RESIDUAL: "Something is missing that no known effect explains",
    Verdict.INSUFFICIENT_EXCITATION: "These recordings cannot tell",
}

GOOD_ENOUGH = 1.3
"""Errors, in times of what is unavoidable, up to which nothing more is asked for."""

EXPLAINS = 0.5
"""Share of what is left that a change, or a candidate that is not sure, must account for to be told of."""


def headline(result: DiagnosisResult) -> str:
    """The verdict in a few words."""
    if quick_and_unexplained(result):
        return "Something is missing that a quick look does not explain"
    if rest := rest_explained_by(result):
        law = "A law of force was learned for what no known effect explains"
        return {"law": law, "change": "What the model lacks does not stay the same"}[rest]
    if result.verdict is Verdict.UNEXPLAINED_RESIDUAL and result.effects:
        return "Something is still missing that no known effect explains"
    if result.verdict is Verdict.NO_MISSING_EFFECT and result.effects:
        return "No effect is missing, but other numerics fit better"
    return HEADLINES[result.verdict]


def rest_explained_by(result: DiagnosisResult) -> Literal["law", "change", ""]:
    """What explains what is left by known effects that stay the same: a law of force, a change; or nothing does."""
    if result.verdict is not Verdict.UNEXPLAINED_RESIDUAL:
        return ""
    laws = without_negligible_laws(result).laws
    if laws is not None and laws.found and laws.after < GOOD_ENOUGH:
        return "law"
    changing = result.changes.found if result.changes is not None else ()
    return "change" if any(f.removed_share >= EXPLAINS for f in changing) else ""


def quick_and_unexplained(result: DiagnosisResult) -> bool:
    """Whether much is left that a quick look did not look for."""
    return bool(result.not_tried) and result.verdict is Verdict.UNEXPLAINED_RESIDUAL


def verdict_in_words(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first; ``model`` tells in which units effects are."""
    makers = {
        Verdict.EFFECTS_FOUND: found_sentences,
        Verdict.NO_MISSING_EFFECT: nothing_missing_sentences,
        Verdict.UNEXPLAINED_RESIDUAL: unexplained_sentences,
        Verdict.INSUFFICIENT_EXCITATION: quiet_sentences,
    }
    result = without_negligible_laws(result)
    said = [*makers[result.verdict](result, model), *judged_by_force_sentences(result)]
    return [
        *said,
        *nearly_named_sentences(result),
        *undecided_sentences(result.effects),
        *implausible_sentences(result),
    ]


def without_negligible_laws(result: DiagnosisResult) -> DiagnosisResult:
    """The result without laws that are too weak for a headline; what is said of laws alone names them."""
    laws = result.laws
    weak = [(f.joint, f.expression) for f in laws.found if f.negligible] if laws is not None else []
    if laws is None or not weak:
        return result
    effects = [e for e in result.effects if (e.target, e.fixed.get("expression")) not in weak]
    found = [f for f in laws.found if (f.joint, f.expression) not in weak]
    return replace(result, effects=effects, laws=replace(laws, found=found))


def size_in_words(laws: LawReport | None, e: EffectEstimate) -> str:
    """How strong an effect is that is a law, with a comma in front; empty of others."""
    found = laws.found if laws is not None else ()
    return "".join(
        f", {law_size(f)}" for f in found if (f.joint, f.expression) == (e.target, e.fixed.get("expression"))
    )


def judged_by_force_sentences(result: DiagnosisResult) -> list[str]:
    """That forecasts were not what models were judged by, and what counts as 1."""
    forces = result.error.unexplained
    if not forces:
        return []
    each = ", ".join(f"{format_number(v)} at {name}" for name, v in forces.items())
    # faults left in the recordings put models off as good sensors do
    why = "" if result.mending else "The sensors are so good that every model is off by far more than their noise. So "
    judged = "models are judged by the force that each leaves unexplained, as in identification by inverse dynamics."
    return [f"{why}{judged if why else judged.capitalize()} 1 is, in N·m or N: {each}."]


# --- what each verdict says -----------------------------------------------------------------------------


def found_sentences(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """What the model lacks, and what adding it gains."""
    return [lacking_sentence(result.effects, model, result.laws), gain_sentence(result)]


def nothing_missing_sentences(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """That the model is as good as the data can show, perhaps with another time step or integrator."""
    level = f"The error is {format_number(result.error.after)} times {result.error.yardstick}"
    good = (
        "; 1 is as good as can be."
        if result.error.after < GOOD_ENOUGH
        else ", but neither state nor commands predict the rest."
    )
    none = "none of the effects tried makes the predictions of episodes not used for fitting surely better."
    limits = [told] if (told := limit_sentence(result.limits)) else []
    if not result.effects:
        return [f"No missing effect: {none}", level + good, *limits]
    numerics = "; ".join(effect_sentence(e, model) for e in result.effects)  # what no verdict counts as missing
    return [
        f"No missing effect, but these recordings ask for other numerics: {numerics}.",
        gain_sentence(result),
        f"Beyond that {none}",
        level + good,
        *limits,
    ]


def unexplained_sentences(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """What was found all the same, and that it does not suffice; or that a law of force does."""
    if result.laws is not None and result.laws.found:
        return with_law_sentences(result, model)
    level = f"{format_number(result.error.after)} times {result.error.yardstick}"
    if not result.effects:
        return [
            f"The model lacks something, and no effect of the library explains it: the error is {level} on episodes "
            "not used for fitting."
        ]
    helps = "; ".join(effect_sentence(e, model) for e in result.effects)
    return [
        f"Part of the error stays unexplained: {level} on episodes not used for fitting is left after all that helps.",
        f"What helps: {helps}.",
        gain_sentence(result),
    ]


def with_law_sentences(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """That no known effect explains the recordings, and how far a learned law does."""
    laws, known = result.laws, [e for e in result.effects if e.effect != LearnedForce.name]
    assert laws is not None, "only where a law was found"
    beside = f" Beside it: {'; '.join(effect_sentence(e, model) for e in known)}." if known else ""
    sizes = "; ".join(f"on joint {f.joint} {law_size(f)}" for f in laws.found)
    return [
        f"The model lacks something that no known effect explains. A law of force was learned for it ({sizes}): the "
        f"error falls from {format_number(laws.before)} to {format_number(laws.after)} times the measurement noise on "
        f"episodes not used for fitting.{beside}"
    ]


def quiet_sentences(result: DiagnosisResult, model: mujoco.MjModel) -> list[str]:
    """That the recordings would not have shown an effect."""
    return [
        "These recordings cannot tell whether something is missing: they move the mechanism so little that even a "
        "strong effect would hide in the measurement noise."
    ]


def gain_sentence(result: DiagnosisResult) -> str:
    """What adding the effects does to the held-out error."""
    error, them = result.error, "it" if len(result.effects) == 1 else "them"
    if f"{error.before:.3g}" == f"{error.after:.3g}":  # what is found shows in other episodes
        return (
            f"On episodes not used for fitting adding {them} changes nothing: the error stays at "
            f"{format_number(error.after)} times {error.yardstick}."
        )
    percent = f"{100 * error.removed_share:.0f} %"
    removes = f"removes {percent} of the removable error" if error.removed_share > 0 else "changes the error"
    return (
        f"Adding {them} {removes} on episodes not used for fitting: from {format_number(error.before)} "
        f"to {format_number(error.after)} times {error.yardstick}."
    )


# --- effects --------------------------------------------------------------------------------------------


def lacking_sentence(effects: Sequence[EffectEstimate], model: mujoco.MjModel, laws: LawReport | None = None) -> str:
    """What was found, as a sentence; ``laws`` are those among it."""
    listed = "; ".join(effect_sentence(e, model) + size_in_words(laws, e) for e in effects)
    new = all(p.nominal in (0, None) for e in effects for p in e.parameters.values())
    what = ("effect" if new else "change") + "s" * (len(effects) > 1)
    how_many = "one" if len(effects) == 1 else str(len(effects))
    return f"The model {'lacks' if new else 'needs'} {how_many} {what}: {listed}."


def effect_sentence(effect: EffectEstimate, model: mujoco.MjModel) -> str:
    """One effect: what, where, how much, and how surely."""
    parts, several = [], len(effect.parameters) > 1
    for name, p in effect.parameters.items():
        value, interval = format_estimate(p.estimate, p.ci95)
        unit = unit_at(model, effect.target, p.unit)
        words = f"{name} {value}" if several else value
        words += f" {unit}" if unit not in ("", "1") else ""
        words += f" (95 %: {interval})" if interval else ""
        words += f" instead of {nominal_in_words(p)}" if p.nominal not in (0, None, p.estimate) else ""
        parts.append(words)
    anyway = EFFECTS[effect.key[0]].told_anyway if effect.key[0] in EFFECTS else ()
    parts += [f"{name} {format_number(v)}" for name, v in effect.fixed.items() if name in anyway]
    return f"{phrase_at(*effect.key)}, {', '.join(parts)}"


def undecided_sentences(effects: Sequence[EffectEstimate]) -> list[str]:
    """Which effects are one of several that explain the data equally well."""
    sentences = []
    for e in effects:
        own = phrase_at(*e.key)
        others = [phrase_at(a.effect, a.target) for a in e.equivalent]
        if others:
            others = ["another form of it" if o == own else o for o in others]
            sentences.append(f"These data cannot tell {own} from {listing(others)}.")
    return sentences


def nearly_named_sentences(result: DiagnosisResult) -> list[str]:
    """Where nothing was found: what would take most of the error off, if it were sure. Few windows may show it.

    Beside what was found there is none: what a candidate gained before that is not what it would gain now.
    """
    if any(e.effect != "numerics" for e in result.effects):
        return []
    rest = result.error.after**2 - 1
    tried = [c for c in result.candidates if not c.implausible]
    best = max(tried, key=lambda c: c.held_out_gain or 0.0, default=None)
    if best is None or result.error.after < GOOD_ENOUGH or (best.held_out_gain or 0.0) < EXPLAINS * rest:
        return []
    values = ", ".join(f"{name} {format_number(value)}" for name, value in best.parameters.items())
    return [
        f"Nearly named: {phrase_at(best.effect, best.target)} ({values}). It would take "
        f"{100 * min(1.0, (best.held_out_gain or 0.0) / rest):.0f} % of the rest off, but: {best.rejected_because}. "
        "Record more motion that shows it."
    ]


def implausible_sentences(result: DiagnosisResult) -> list[str]:
    """What is named last, or not at all, since no real machine has it."""
    sentences = [
        f"{phrase_at(*e.key).capitalize()} is named last: {e.implausible}. Nothing plausible explains these recordings "
        "as well; look at the model there, or for a cause that no effect describes."
        for e in result.effects
        if e.implausible
    ]
    named = {e.key for e in result.effects}
    refused = [c for c in result.candidates if c.implausible and (c.effect, c.target) not in named]
    best = max(refused, key=lambda c: c.held_out_gain or 0.0, default=None)
    if best is not None and not sentences:
        what = phrase_at(best.effect, best.target)
        sentences.append(f"Not named, though it would make predictions better: {what}. {best.rejected_because}.")
    return [s[0].upper() + s[1:] for s in sentences]


def estimate_cells(effect: EffectEstimate, model: mujoco.MjModel) -> list[tuple[str, str, str, str, str]]:
    """A row for each parameter of an effect: its name, estimate, interval, unit, and value in the model."""
    return [
        (name, value, interval or "-", unit_at(model, effect.target, p.unit), nominal_in_words(p))
        for name, p in effect.parameters.items()
        for value, interval in [format_estimate(p.estimate, p.ci95)]
    ]


def nominal_in_words(p: ParameterEstimate) -> str:
    """What a parameter is in the model; "-" where that has none."""
    if p.nominal is None:
        return "-"
    return p.nominal if isinstance(p.nominal, str) else format_number(p.nominal)


# --- errors ---------------------------------------------------------------------------------------------


def error_rows(result: DiagnosisResult) -> list[tuple[str, float, str]]:
    """The table before, after, floor, ceiling: name, value, what it means."""
    error = result.error
    given = "the model as it was given" + (", with the effects declared" if result.declared else "")
    return [
        ("before", error.before, given),
        ("after", error.after, "with the effects found" if result.effects else "the same: nothing was added"),
        ("noise floor", ErrorTable.NOISE_FLOOR, f"a perfect model: {error.yardstick} alone"),
        ("ceiling", error.ceiling, "the given model, corrected by a black box (a regression on state and commands)"),
    ]


def episode_list(numbers: Sequence[int], most: int = 12) -> str:
    """As in "episodes 0, 1, 2", or how many there are where they are more than anyone reads."""
    if len(numbers) > most:
        return f"{len(numbers)} episodes"
    return f"episode{'s' * (len(numbers) != 1)} {', '.join(map(str, numbers))}"


def worst_channels(channels: Mapping[str, ChannelError], most: int = 4) -> list[str]:
    """The 2 to ``most`` channels with the largest error relative to noise, in the model's order."""
    ratio = np.array([c.before / max(c.noise, 1e-12) for c in channels.values()])
    keep = np.argsort(-ratio)[:most]
    names = list(channels)
    return [names[i] for i in np.sort(keep[(ratio[keep] > 0.1 * ratio.max()) | (np.arange(len(keep)) < 2)])]
