"""Deployment faults on the page of a diagnosis, and in words for the terminal."""

from __future__ import annotations

from idapt_pl.deployment_faults import DeploymentFault, FaultReport
from idapt_pl.effects.wording import format_number
from idapt_pl.report.html import paragraph, row, section, table

FAULT_HEADS = ("deployment fault", "where", "#estimate", "#95 % interval", "#gain", "cure", "could also be")


def fault_sentence(fault: DeploymentFault) -> str:
    """One fault: what, where, how much, what to do."""
    where = f" ({fault.where})" if fault.where else ""
    also = f" It could also be the {' or the '.join(fault.could_also_be)}." if fault.could_also_be else ""
    return f"Deployment fault: {fault.words}{where}. Cure: {fault.cure}.{also}"


def consequence(fixed: bool) -> str:
    """What the rest of the diagnosis is of."""
    if fixed:
        return "The faults were taken out of the recording; what follows is of the mended one, mended.h5."
    return (
        "What follows is of the recording as it is, so its effects may stand for these faults. "
        "With --fix they are taken out first."
    )


def fault_section(report: FaultReport | None, fixed: bool, file: str = "") -> str:
    """The section of the page, of one of several files; empty where nothing was tested or found."""
    if report is None or not report.faults:
        return ""
    rows = [row(*fault_cells(f)) for f in report.faults]
    caption = (
        "Gain: by what factor the cure lowers squared errors of short forecasts, over all degrees of freedom, as a "
        "logarithm, on parts of the recording by which it was not chosen."
    )
    title = f"Deployment faults of {file}" if file else "Deployment faults"
    return section(title, paragraph(consequence(fixed)), table(FAULT_HEADS, rows), paragraph(caption, "small"))


def fault_cells(f: DeploymentFault) -> tuple[str, ...]:
    """A fault as cells of the table."""
    interval = "-" if f.ci95 is None else " to ".join(format_number(x) for x in f.ci95)
    gain = "-" if f.gain is None else f"{format_number(f.gain)} ± {format_number(f.gain_error or 0.0, 2)}"
    estimate = "-" if isinstance(f.estimate, tuple) else f.value
    numbers = (f"#{estimate}", f"#{interval}", f"#{gain}")
    return (f.words, f.where or "all", *numbers, f.cure, "; ".join(f.could_also_be) or "-")
