"""The part of a diagnosis about laws of force, on the page and in the terminal."""

from __future__ import annotations

from idapt_pl.diagnosis.answer.law_result import LawFinding, LawReport
from idapt_pl.diagnosis.laws.places import ResidualPlace
from idapt_pl.effects.expression import SIGNALS
from idapt_pl.effects.wording import format_estimate, format_number, listing
from idapt_pl.report.html import details, paragraph, row, section, table

HISTORY = "what was before"


def law_sentences(laws: LawReport | None) -> list[str]:
    """What a search for laws came to, the most important first; nothing where none was made."""
    if laws is None:
        return []
    sentences = [law_sentence(f) for f in laws.found]
    if laws.needless:
        sentences.append(f"With it these are needless: {', '.join(laws.needless)}.")
    if laws.network is not None:
        sentences.append(
            f"No law was found. A black box (a small network of {', '.join(laws.network.inputs)}) on joint "
            f"{laws.network.joint} removes {percent(laws.network.share)} of what no effect explains: it says where the "
            "rest is, not what it is."
        )
    if laws.sensor:
        sentences.append(
            f"The rest looks like an error of the position sensor of {laws.sensor} that changes with its angle, rather "
            "than like a force: an encoder off its axis, or a table of corrections."
        )
    if not sentences:
        sentences.append("No law of force explains the rest either" + where_it_is(laws) + ".")
    return sentences


def law_sentence(f: LawFinding) -> str:
    """One law."""
    little = " That is next to nothing, so it is said here alone." if f.negligible else ""
    return (
        f"A law for it: on joint {f.joint} acts {f.formula} {f.unit}, which depends on {names(f.depends)}, "
        f"{law_size(f)}. It removes {percent(f.share)} of what is above the noise without it, on episodes not used for "
        f"fitting.{little}"
    )


def law_size(f: LawFinding) -> str:
    """How strong a law is, beside what acts on its joint anyway."""
    share = f"{format_number(100 * f.largest_share, 2)} %"
    return f"at most {format_number(f.largest, 2)} {f.unit}, {share} of the usual force there"


def where_it_is(laws: LawReport) -> str:
    """Where most of the residual is."""
    if not laws.where or laws.where[0].share < 0.05:
        return ""
    p = laws.where[0]
    return f"; a {p.kind} at {p.joint} that follows {names(p.follows)} would explain {percent(p.share)} of it"


def law_section(laws: LawReport | None) -> str:
    """The laws, with their coefficients, what else was tried and where the residual lives; empty without a search."""
    if laws is None:
        return ""
    parts = [paragraph(s) for s in law_sentences(laws)]
    rows = [
        row(f.joint if k == 0 else "", f.expression if k == 0 else "", name, f"#{value}", f"#{interval}", p.unit)
        for f in laws.found
        for k, (name, p) in enumerate(f.parameters.items())
        for value, interval in [format_estimate(p.estimate, p.ci95)]
    ]
    if rows:
        heads = ("joint", "force", "coefficient", "#estimate", "#95 % interval", "unit")
        parts.append(table(heads, rows))
        used = sorted({s for f in laws.found for s in f.depends if s in SIGNALS})
        parts.append(paragraph("; ".join(f"{s}: {SIGNALS[s]}" for s in used) + ".", "small"))
    others = [row(joint, text, f"#{format_number(e)}") for f in laws.found for joint, text, e in f.others]
    if others:
        parts.append(details("Other formulas", table(("joint", "force", "#error"), others)))
    if laws.where:
        rows = [place_row(p) for p in laws.where]
        parts.append(
            details("Where the rest is, by regression", table(("joint", "as a", "#explains", "follows"), rows))
        )
    errors = f"Error before {format_number(laws.before)}, after {format_number(laws.after)}"
    parts.append(paragraph(f"{errors}; the search took {format_number(laws.seconds)} s.", "small"))
    return section("A law for what no known effect explains", *parts)


def place_row(p: ResidualPlace) -> str:
    """One place."""
    return row(p.joint, p.kind, f"#{percent(p.share)}", names(p.follows))


def percent(share: float) -> str:
    """As in "93 %"."""
    return f"{100 * share:.0f} %"


def names(signals: tuple[str, ...]) -> str:
    """Signals in words."""
    words = {"q": "position", "v": "velocity", "u": "command", "motor": "motor force", "t": "time", "history": HISTORY}
    return listing(words.get(s, s) for s in signals).replace(" or ", " and ") if signals else "nothing"
