"""The diagnosis as one HTML page, the verdict on top."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import matplotlib
import mujoco
from matplotlib.figure import Figure

from idapt_pl.diagnosis.answer.repaired import RepairedModel
from idapt_pl.diagnosis.answer.result import DiagnosisResult, Verdict
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.effects.wording import format_number, listing, phrase_at
from idapt_pl.report.change_section import change_section
from idapt_pl.report.diagnosis_wording import episode_list, error_rows, estimate_cells, headline, verdict_in_words
from idapt_pl.report.explanation_section import as_number, explanation_section
from idapt_pl.report.html import document, paragraph, row, section, table
from idapt_pl.report.law_section import law_section
from idapt_pl.report.limits_section import limits_section
from idapt_pl.report.minute_section import minute_section
from idapt_pl.report.next_steps import linked_name, next_steps_section
from idapt_pl.report.plots import STYLE, svg
from idapt_pl.report.split_section import split_section

SHOWN_ROWS = 25
"""Ranked candidates that are not folded away."""

TONES = {
    Verdict.EFFECTS_FOUND: "#1d6fa5",
    Verdict.NO_MISSING_EFFECT: "#2f7d3b",
    Verdict.UNEXPLAINED_RESIDUAL: "#b4452c",
    Verdict.INSUFFICIENT_EXCITATION: "#8a6d1a",
}


def diagnosis_page(
    diagnosis: Diagnosis, repaired: RepairedModel, drawn: dict[str, Figure], model_name: str, data_name: str,
    notes: Sequence[str] = (), warnings: Sequence[str] = (), settings: str = "",
) -> str:  # fmt: skip
    """The whole page.

    Args:
        diagnosis: finished.
        repaired: the model before and after.
        drawn: figures.
        model_name: of the nominal model.
        data_name: of the recordings.
        notes: sections about the recordings themselves.
        warnings: the same in a sentence each.
        settings: the section of values to set.
    """
    result, model = diagnosis.result, diagnosis.sim.model
    sections = [
        verdict_header(result, model, model_name, data_name),
        minute_section(result, diagnosis.sim, warnings),
        *notes,
        effects_section(result, model),
        explanation_section(result.explanations, result.error),
        split_section(result.splits),
        settings,
        next_steps_section(result.effects, result.next_experiment),
        limits_section(result.limits),
        change_section(result.changes),
        law_section(result.laws),
        error_section(result),
        signature_section(result),
        picture_sections(diagnosis, drawn),
        model_difference_section(repaired, bool(diagnosis.declared)),
        candidates_section(diagnosis),
        settings_section(diagnosis, model_name, data_name),
    ]
    return document(f"{headline(result)}: {model_name}", sections, TONES[result.verdict])


def verdict_header(result: DiagnosisResult, model: mujoco.MjModel, model_name: str, data_name: str) -> str:
    """The verdict in words."""
    first, *more = verdict_in_words(result, model)
    return (
        f'<header>\n<p class="small">{escape(model_name)} against {escape(data_name)}</p>\n'
        f"<h1>{escape(headline(result))}</h1>\n"
        + "\n".join([paragraph(first, "lead"), *map(paragraph, more)])
        + "\n</header>"
    )


def error_section(result: DiagnosisResult) -> str:
    """The table before, after, floor, ceiling."""
    error = result.error
    forecasts = f" ({format_number(error.horizon_s)} s), each from its first measured state"
    forecasts = "" if error.unexplained else forecasts
    return section(
        "Error on episodes not used for fitting",
        table(("", "#error", ""), (row(name, f"#{format_number(v)}", what) for name, v, what in error_rows(result))),
        paragraph(
            f"In standard deviations of {error.yardstick}: {error.metric}{forecasts}. "
            f"Judged on {episode_list(error.held_out_episodes)}.",
            "small",
        ),
    )


def effects_section(result: DiagnosisResult, model: mujoco.MjModel) -> str:
    """Estimates with intervals and units; intervals may break, as the table is wide."""
    rows = []
    for e in result.effects:
        others = listing(phrase_at(a.effect, a.target) for a in e.equivalent) if e.equivalent else ""
        for i, (name, value, interval, unit, nominal) in enumerate(estimate_cells(e, model)):
            what = linked_name(e) if i == 0 else ""
            sure = as_number(e.probability) if e.probability is not None and i == 0 else ""
            cells = (what, name, f"#{value}", interval, unit, f"#{nominal}", sure, others if i == 0 else "")
            rows.append(row(*cells))
    if not rows:
        return ""
    heads: tuple[str, ...] = (
        "effect", "parameter", "#estimate", "95 % interval", "unit", "#in the model", "#probable", "could also be",
    )  # fmt: skip
    if not any(e.equivalent for e in result.effects):
        heads, rows = heads[:-1], [r.replace("<td></td></tr>", "</tr>") for r in rows]
    return section("Effects to add", table(heads, rows))


def signature_section(result: DiagnosisResult) -> str:
    """What an unexplained residual looks like."""
    text = result.signature
    return section("What the unexplained part looks like", paragraph(text[0].upper() + text[1:])) if text else ""


def picture_sections(diagnosis: Diagnosis, drawn: dict[str, Figure]) -> str:
    """The plots."""
    shown = {
        "prediction": (
            "Measured and predicted",
            "The channels with the largest error for their noise, in held-out windows where the error is typical. "
            "Every window starts anew at the measured state, so even a perfect model may leave the band a little.",
        ),
        "residual_by_channel": (
            "Residual by channel",
            "Held-out windows, on a logarithmic scale. A perfect model stays somewhat above the noise, because the "
            "measured state that every window starts at is noisy too.",
        ),
    }
    parts = []
    with matplotlib.rc_context(STYLE):
        for name, (title, caption) in shown.items():
            picture = f'<div class="wide">{svg(drawn[name])}</div>'
            parts.append(
                section(title, f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"),
            )
    return "\n".join(parts)


def model_difference_section(repaired: RepairedModel, declared: bool) -> str:
    """The MJCF difference, and what MJCF cannot say; whether effects were declared before."""
    kinds = {"+": "add", "-": "cut", "@": "at"}
    lines = [
        f'<span class="{kinds.get(line[0], "")}">{escape(line)}</span>' if line[:1] in kinds else f"<span>{line}</span>"
        for line in (escape(d) if d[:1] not in kinds else d for d in repaired.difference()[2:])
    ]
    parts = [f'<div class="wide"><pre>{"".join(lines)}</pre></div>'] if lines else []
    if repaired.unsaid:
        names = listing(phrase_at(e.name, e.target) for e in repaired.unsaid).replace(" or ", " and ")
        parts.append(paragraph(f"MJCF has no words for {names}: in effects.yaml alone, not in patched.xml."))
    if not parts:
        return ""
    if lines:
        note = "As in patched.xml" + (", effects declared before included." if declared else ".")
        parts.append(paragraph(note, "small"))
    return section("Change of the model (MJCF)", *parts)


def candidates_section(diagnosis: Diagnosis) -> str:
    """Everything tried, ranked in each round, and why it lost."""
    trials = sorted(diagnosis.trials, key=lambda t: (t.round, -t.score))
    kept = {(*e.key, *e.parameters) for e in diagnosis.result.effects}
    rows, last = [], None
    for t in trials:
        if t.round != last:
            rows.append(f'<tr class="round"><td colspan="4">Round {t.round + 1}</td></tr>')
            last = t.round
        rows.append(candidate_row(t, kept))
    if not rows:
        return ""
    heads = ("candidate", "#score", "#held-out gain", "why it lost")
    parts = [table(heads, rows[:SHOWN_ROWS])]
    if len(rows) > SHOWN_ROWS:
        more = table(heads, rows[SHOWN_ROWS:])
        parts.append(f"<details><summary>{len(rows) - SHOWN_ROWS} more</summary>\n{more}\n</details>")
    caption = (
        "Score: squared error that a small dose of the effect explains, in units of the noise. Held-out gain: what a "
        "refit with it takes off the mean squared error of held-out windows; only the best of each round are refitted."
    )
    return section("Candidates", *parts, paragraph(caption, "small"))


def candidate_row(t: Trial, kept: set[tuple[str, ...]]) -> str:
    """One candidate in one round."""
    c = t.candidate
    fixed = "".join(f", {name} {format_number(v)}" for name, v in c.fixed if isinstance(v, float) and c.size > 1)
    name = f"{phrase_at(c.kind.name, c.target)} ({', '.join(c.names)}{fixed})"
    gain = "#-" if t.gain != t.gain else f"#{format_number(t.gain)} ± {format_number(t.gain_error, 2)}"
    if t.rejection:
        return row(name, f"#{format_number(t.score)}", gain, t.rejection.text)
    fate = "accepted" if (c.kind.name, c.target, *c.names) in kept else "accepted, later needless: left out again"
    return row(name, f"#{format_number(t.score)}", gain, fate, kind="accepted" if fate == "accepted" else "")


def settings_section(diagnosis: Diagnosis, model_name: str, data_name: str) -> str:
    """Where the numbers come from."""
    result, sim = diagnosis.result, diagnosis.sim
    error, steps = result.error, sum(map(len, sim.data))
    declared = ", ".join(phrase_at(e.name, e.target) for e in diagnosis.declared)
    rows = [
        ("model", f"{model_name}; degrees of freedom: {sim.model.nv}, actuators: {sim.model.nu}"),
        (
            "recordings",
            f"{data_name}; episodes: {len(sim.data)}, steps: {steps} of {format_number(sim.control_period)} s",
        ),
        ("fitted on", episode_list(error.fit_episodes)),
        ("judged on", episode_list(error.held_out_episodes)),
        ("windows", f"{format_number(error.horizon_s)} s; {len(diagnosis.held_out)} held out"),
        ("compared", "positions and velocities" if sim.velocities else "positions; velocities are their slopes"),
        ("declared effects", declared or "none"),
        ("runtime", f"{format_number(result.runtime_s)} s, {sim.calls} batches of simulations"),
        ("made with", f"MuJoCo {mujoco.__version__}; schema {result.SCHEMA}"),
    ]
    return section("Settings", table(("", ""), (row(*r) for r in rows)))
