"""The report of a run: no scripts, nothing fetched, the outcome on top, then the story step by step."""

from __future__ import annotations

import json
from pathlib import Path

from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.files import write_atomically
from idapt_pl.report.html import (
    TONE,
    details,
    document,
    figure,
    header,
    paragraph,
    preformatted,
    row,
    scrollable,
    section,
    table,
    tile,
    tiles,
)
from idapt_pl.report.plots import svg
from idapt_pl.report.run_figures import returns_figure
from idapt_pl.report.run_record import RunRecord, read_run_record
from idapt_pl.report.run_step import step_section
from idapt_pl.report.run_wording import format_result, format_score, step_name
from idapt_pl.run import Run
from idapt_pl.stages.shortened import shortened_sentence
from idapt_pl.targets import target_name

MARKED_CSS = "section.rolled, section.shortened { border-left: 6px solid #b4452c; }\n"
"""Marks steps whose F was rolled back, and what is said of a run that was shortened."""


def write_run_report(run: Run, path: Path | None = None) -> Path:
    """Write ``report.html`` of a run, finished or not, from its folder; nothing is simulated. Returns its path."""
    path = path or run.folder / "report.html"
    text = run_page(read_run_record(run.folder), run)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return path


def run_page(record: RunRecord, run: Run) -> str:
    """The whole page."""
    metric = run.worlds.task.metric
    parts = [shortened_section(record), outcome_header(record, metric), missing_section(record)]
    parts += [warnings_section(record), known_section(record)]
    parts.append(returns_section(record, metric))
    steps = () if record.stepless else record.steps
    parts += [step_section(record, step, metric, run) for step in steps]
    parts += [times_section(record), ledger_section(record), run_settings_section(record)]
    title = f"{record.config['task']}: source to {target_name(record.config['target'])}, seed {record.config['seed']}"
    return document(title, parts, TONE, MARKED_CSS)


def shortened_section(record: RunRecord) -> str:
    """What a run whose lengths were divided is worth; nothing where they were not."""
    said = shortened_sentence(record.provenance.get("shortened_by", 1.0))
    return section("A shortened run", paragraph(f"{said.capitalize()}.", "lead"), kind="shortened") if said else ""


def outcome_header(record: RunRecord, metric: str) -> str:
    """The headline, and the numbers that matter."""
    c, last = record.config, record.evaluated[-1:]
    head = "No step has been evaluated yet"
    if record.reference:
        head = f"{metric.capitalize()} in the target: {format_score(record.reference['mean'], metric)}"
    elif last and not last[0].evaluation["target"]:
        grounded = format_score(last[0].evaluation["grounded"]["mean"], metric)
        head = f"{metric.capitalize()} in the grounded source: {grounded}; the target is not measured"
    elif last:
        head = f"{metric.capitalize()} in the target: {format_score(last[0].evaluation['target']['mean'], metric)}"
        if record.direct_transfer:
            head += f", where direct transfer has {format_score(record.direct_transfer['mean'], metric)}"
    made = [result_tile("direct transfer", record.direct_transfer, metric)]
    made += [result_tile(step_name(s).lower(), s.evaluation["target"], metric, s in last) for s in record.evaluated]
    made += [result_tile("oracle", record.oracle, metric, missing="not trained")]
    used = max((s.interactions for s in record.steps), default=0)
    made.append(tile(f"{used:,}", "target interactions"))
    p = record.provenance
    about = [
        f"{c['task']}, source to {target_name(c['target'])}, seed {c['seed']}; {p.get('started', 'date unknown')[:10]}",
        f"commit {(p.get('git_commit') or 'unknown')[:10]}{'+dirty' * str(p.get('git_commit')).endswith('+dirty')}",
        f"idapt {p.get('versions', {}).get('idapt', '?')}, method {record.method}",
        str(p.get("device", "device unknown")),
    ]
    told = c["target"].get("actions") if isinstance(c["target"], dict) else None
    if told:
        about.append("the target's actions are the source's with " + ", ".join(f"{k} {v}" for k, v in told.items()))
    but = " but the oracle" if record.oracle else ""
    note = paragraph(
        f"The {metric} in the target is for evaluation only: nothing in the run{but} was trained or selected on "
        "it. The method saw the target's images and its own actions.",
        "small",
    )
    return header(head, tiles(*made), note, note=", ".join(about))


def result_tile(name: str, result: dict, metric: str, best: bool = False, missing: str = "not measured") -> str:
    """A result as one of the headline numbers."""
    return tile(format_result(result, metric) if result else missing, name, "best" * best)


def missing_section(record: RunRecord) -> str:
    """What is missing, and how to get it."""
    parts = []
    if not record.finished and record.stepless:
        parts.append(f"The run has not ended. To go on: idapt fit --config {record.run / 'config.yaml'}")
    elif not record.finished:
        done = len(record.evaluated)
        parts.append(
            f"The run has not ended: {done} of {record.planned + 1} steps are done (step 0 included). "
            f"To go on where it stopped: idapt fit --config {record.run / 'config.yaml'}"
        )
    if record.unreadable:
        parts.append(f"These files cannot be read and are left out: {', '.join(record.unreadable)}.")
    return section("What is missing", *map(paragraph, parts)) if parts else ""


def warnings_section(record: RunRecord) -> str:
    """What the run warned of; nothing where it did not."""
    return section("What the run warned of", *map(paragraph, record.warnings)) if record.warnings else ""


def known_section(record: RunRecord) -> str:
    """Effects that the config gave the source beforehand; nothing where it gave none."""
    rows = [
        row(
            phrase_at(e["effect"], e["target"]),
            ", ".join(f"{k} {told_parameter(v)}" for k, v in e["parameters"].items()),
        )
        for e in record.config.get("effects", {}).get("known") or ()
    ]
    if not rows:
        return ""
    note = paragraph("The config adds these to the source before anything is learned (effects.known).", "small")
    return section("Known beforehand", table(["effect", "parameters"], rows), note)


def told_parameter(value: object) -> str:
    """A parameter's value: a number, a word, or several of them."""
    return format_number(value) if isinstance(value, int | float) else str(value)


def returns_section(record: RunRecord, metric: str) -> str:
    """Returns against what they cost."""
    if not any(s.evaluation["target"] for s in record.evaluated):
        return ""
    caption = "Every point is a policy, at the target interactions that had been used to make it. "
    caption += (
        "The oracle's own are in the ledger below." if record.oracle else "There is no oracle; --oracle true adds it."
    )
    picture = scrollable(svg(returns_figure(record, metric)))
    return section("Against target interactions", figure(picture, caption))


def times_section(record: RunRecord) -> str:
    """Minutes of every stage, a column a step."""
    names = list(dict.fromkeys(name for s in record.steps for name in s.seconds))
    if not names:
        return ""
    total = sum(sum(s.seconds.values()) for s in record.steps)

    def cells(values: list[float | None]) -> list[str]:
        known = [v for v in values if v is not None]
        return [*("#-" if v is None else f"#{v / 60:.1f}" for v in values), f"#{sum(known) / 60:.1f}"]

    rows = [row(name.replace("_", " "), *cells([s.seconds.get(name) for s in record.steps])) for name in names]
    rows.append(row("together", *cells([sum(s.seconds.values()) for s in record.steps]), kind="accepted"))
    heads = ("stage", *(f"#step {s.k}" for s in record.steps), "#all")
    return section(f"Time: {total / 60:.0f} minutes", table(heads, rows), paragraph("In minutes.", "small"))


def ledger_section(record: RunRecord) -> str:
    """Every target interaction."""
    if not record.ledger:
        return section("Target interactions", paragraph("None has been made yet."))
    rows = []
    for e in sorted(record.ledger, key=lambda e: (e["purpose"] != "training", e["step"])):
        mine = e["purpose"] == "training"
        where = f"step {e['step']}" if e["step"] >= 0 else "afterwards"
        rows.append(row(e["purpose"], where, f"#{e['count']:,}", kind="accepted" if mine else ""))
    used = sum(e["count"] for e in record.ledger if e["purpose"] == "training")
    return section(
        f"Target interactions: {used:,}",
        table(("purpose", "when", "#control steps"), rows),
        paragraph("The method used those for training; evaluation and references are entered apart.", "small"),
    )


def run_settings_section(record: RunRecord) -> str:
    """How to make the run again."""
    p = record.provenance
    versions = ", ".join(f"{k} {v}" for k, v in p.get("versions", {}).items())
    commits = dict.fromkeys([p.get("git_commit"), *(r.get("git_commit") for r in p.get("resumed", []))])
    rows = [
        row(
            "task",
            f"{record.config['task']}, target {target_name(record.config['target'])}, seed {record.config['seed']}",
        ),
        row("started", p.get("started", "unknown: run.json is missing")),
        row("commits", ", ".join(str(c) for c in commits)),
        row("machine", f"{p.get('device', '?')}; {p.get('cpu', '?')}; {p.get('platform', '?')}"),
        row("versions", f"python {p.get('python', '?')}, {versions}"),
    ]
    folded = details("Schedule", preformatted(json.dumps(record.config["schedule"], indent=2)))
    note = paragraph("The complete config is config.yaml in the run folder.", "small")
    return section("Settings", table(("", ""), rows), folded, note)
