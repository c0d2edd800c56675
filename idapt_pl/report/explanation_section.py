"""How probable the explanations are that the recordings leave."""

from __future__ import annotations

from collections.abc import Sequence

from idapt_pl.diagnosis.answer.explanation import Explanation, Standing
from idapt_pl.diagnosis.answer.false_discoveries import SUREST
from idapt_pl.diagnosis.answer.result import DiagnosisResult, ErrorTable
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.report.html import paragraph, row, section, table

LEAST = 0.005
"""Explanations that are less probable are counted, not listed."""


def explanation_section(explanations: Sequence[Explanation], error: ErrorTable) -> str:
    """A table of explanations, the most probable first, and of what none of them is; nothing where none is left.

    ``error`` is what remains with what was found.
    """
    if not explanations:
        return ""
    found = next(e for e in explanations if e.standing is Standing.FOUND)
    ranked = sorted(explanations, key=lambda e: -e.probability)
    shown = [e for e in ranked if e.probability >= LEAST or e is found]
    rows = [row(account(e, found), as_number(e.probability), f"#{format_number(e.loss)}") for e in shown]
    rows.append(row("something else, or something more", as_number(something_else(explanations)), ""))
    hidden = len(ranked) - len(shown)
    more = f" {hidden} more are less probable than {as_number(LEAST)[1:]}." * (hidden > 0)
    return section(
        "How probable is it?",
        table(("explanation", "#probability", "#error left (squared)"), rows),
        paragraph(
            "By what each says of held-out windows, how many numbers it needs, and how usual its effects are on "
            f"machines. With what was found, {what_is_left(error)}.{more}",
            "small",
        ),
    )


def probability_sentences(explanations: Sequence[Explanation], error: ErrorTable) -> list[str]:
    """How probable what was found is, and something else, and what is left; nothing where nothing was found."""
    if not explanations:
        return []
    found = next(e for e in explanations if e.standing is Standing.FOUND)
    other = something_else(explanations)
    return [
        f"Just these effects: {found.probability:.0%} probable; something else, or something more: {other:.0%}; "
        f"{what_is_left(error)}."
    ]


def what_is_left(error: ErrorTable) -> str:
    """The error with what was found: all of what can be removed may be, and yet more be there than noise."""
    return f"what is left is {format_number(error.after)} times {error.yardstick}"


def not_named_sentences(result: DiagnosisResult) -> list[str]:
    """What a false discovery rate left out."""
    if not result.not_named:
        return []
    told = all_of([f"{phrase_at(*e.key)} ({e.probability:.0%} probable)" for e in result.not_named])
    asked = result.false_discovery_rate or 0.0
    told = f"Not named, as more than {asked:.2g} of what is named would be expected to be false with it: {told}."
    if asked >= 1 - SUREST:
        return [told]
    never = f"At a rate below {1 - SUREST:.2g} nothing is ever named: no effect is more probable than {SUREST:.3g}."
    return [told, never]


def something_else(explanations: Sequence[Explanation]) -> float:
    """Probability that none of them is right."""
    return max(1.0 - sum(e.probability for e in explanations), 0.0)


def account(e: Explanation, found: Explanation) -> str:
    """An explanation by what it has in the place of what was found."""
    phrases = [phrase_at(x.effect.name, x.effect.target) for x in e.effects]
    if e is found:
        return f"what was found: {all_of(phrases)}"
    before = [phrase_at(x.effect.name, x.effect.target) for x in found.effects]
    new, gone = [p for p in phrases if p not in before], [p for p in before if p not in phrases]
    return f"{all_of(new)} in place of {all_of(gone)}" if new and gone else all_of(phrases)


def all_of(phrases: Sequence[str]) -> str:
    """As in "a, b and c"."""
    return " and ".join(filter(None, [", ".join(phrases[:-1]), phrases[-1]]))


def as_number(share: float) -> str:
    """A probability, as a number cell."""
    return f"#{100 * share:.1f} %" if share < 0.1 else f"#{100 * share:.0f} %"
