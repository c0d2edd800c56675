"""The diagnosis as one HTML page: no scripts, nothing fetched, the verdict on top."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import matplotlib
import mujoco
import numpy as np
from matplotlib.figure import Figure

from idapt_pl.diagnosis.figures import STYLE, svg
from idapt_pl.diagnosis.repaired import Repaired
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.diagnosis.state import Tried
from idapt_pl.diagnosis.words import (
    episodes,
    error_rows,
    estimate,
    headline,
    listing,
    meaning,
    number,
    unit_at,
    verdict_in_words,
)

SHOWN = 25
"""Ranked candidates that are not folded away."""

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: #222; background: #f4f5f7;
       margin: 0; }
main { max-width: 56rem; margin: 0 auto; padding: 1rem; }
section, header { background: #fff; border: 1px solid #e3e5e8; border-radius: 10px; padding: 1rem 1.25rem;
                  margin: 0 0 1rem; }
header { border-left: 6px solid var(--tone); }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .5rem; color: var(--tone); }
h2 { font-size: 1.1rem; margin: 0 0 .5rem; }
p { margin: 0 0 .6rem; }
p:last-child { margin-bottom: 0; }
.lead { font-size: 1.1rem; }
.small, figcaption { color: #62666d; font-size: .87rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .93rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .75rem .35rem 0; border-bottom: 1px solid #eceef0; }
th { font-weight: 600; color: #62666d; }
.named td:first-child { min-width: 11rem; }
.wide + p, figcaption { margin-top: .5rem; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.accepted td { background: #eef7ee; }
tr.round td { color: #62666d; font-weight: 600; padding-top: .9rem; }
figure { margin: 0; }
figure svg { width: 100%; min-width: 30rem; height: auto; display: block; }
pre { font: .82rem/1.45 ui-monospace, Menlo, Consolas, monospace; margin: 0; }
pre span { display: block; white-space: pre; }
.add { background: #e6f4e6; } .cut { background: #fbe9e9; } .at { color: #8a8f98; }
code { font: .9em ui-monospace, Menlo, Consolas, monospace; }
details { margin-top: .5rem; } summary { cursor: pointer; color: #35597e; }
"""

TONES = {
    "effects_found": "#1d6fa5",
    "no_missing_effect": "#2f7d3b",
    "unexplained_residual": "#b4452c",
    "insufficient_excitation": "#8a6d1a",
}


def page(diagnosis: Diagnosis, repaired: Repaired, drawn: dict[str, Figure], model_name: str, data_name: str) -> str:
    """The whole page."""
    report, model = diagnosis.report, diagnosis.sim.model
    sections = [
        verdict(report, model, model_name, data_name),
        errors(report),
        effects(report, model),
        signature(report),
        next_experiment(report),
        pictures(diagnosis, drawn),
        difference(repaired, bool(diagnosis.declared)),
        candidates(diagnosis),
        settings(diagnosis, model_name, data_name),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(headline(report))}: {escape(model_name)}</title>\n"
        f"<style>{CSS}:root {{ --tone: {TONES[report['verdict']]}; }}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(s for s in sections if s)
        + "\n</main>\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """One box of the page."""
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table that scrolls sideways where it does not fit; heads that start with ``#`` are of numbers."""
    kind = ' class="named"' if head[0] else ""
    titles = "".join(
        f'<th class="n">{escape(h[1:])}</th>' if h.startswith("#") else f"<th>{escape(h)}</th>" for h in head
    )
    return f'<div class="wide"><table{kind}>\n<tr>{titles}</tr>\n' + "\n".join(rows) + "\n</table></div>"


def row(*cells: str, kind: str = "") -> str:
    """A row of cells; those that start with ``#`` are numbers."""
    made = "".join(
        f'<td class="n">{escape(c[1:])}</td>' if c.startswith("#") else f"<td>{escape(c)}</td>" for c in cells
    )
    return f'<tr class="{kind}">{made}</tr>' if kind else f"<tr>{made}</tr>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


# --- the parts, from top to bottom ------------------------------------------------------------------


def verdict(report: dict, model: mujoco.MjModel, model_name: str, data_name: str) -> str:
    """The verdict in words."""
    first, *more = verdict_in_words(report, model)
    return (
        f'<header>\n<p class="small">{escape(model_name)} against {escape(data_name)}</p>\n'
        f"<h1>{escape(headline(report))}</h1>\n"
        + "\n".join([paragraph(first, "lead"), *map(paragraph, more)])
        + "\n</header>"
    )


def errors(report: dict) -> str:
    """The table before, after, floor, ceiling."""
    error = report["error"]
    return section(
        "Error on episodes not used for fitting",
        table(("", "#error", ""), (row(name, f"#{number(v)}", what) for name, v, what in error_rows(report))),
        paragraph(
            f"In {error['unit']}: {error['metric']} ({number(error['horizon_s'])} s), each predicted from its first "
            f"measured state. Judged on {episodes(error['held_out_episodes'])}.",
            "small",
        ),
    )


def effects(report: dict, model: mujoco.MjModel) -> str:
    """Estimates with intervals and units."""
    rows = []
    for e in report["effects"]:
        others = listing(meaning(q["effect"], q["target"]) for q in e["equivalent"]) if e.get("equivalent") else ""
        for i, (name, p) in enumerate(e["parameters"].items()):
            value, interval = estimate(p["estimate"], p["ci95"])
            nominal = p["nominal"] if isinstance(p["nominal"], str) else number(p["nominal"])
            what = meaning(e["effect"], e["target"]) if i == 0 else ""
            unit = unit_at(model, e["target"], p["unit"])
            cells = (what, name, f"#{value}", f"#{interval or '-'}", unit, f"#{nominal}", others if i == 0 else "")
            rows.append(row(*cells))
    if not rows:
        return ""
    heads = ("effect", "parameter", "#estimate", "#95 % interval", "unit", "#in the model", "could also be")
    if not any(e.get("equivalent") for e in report["effects"]):
        heads, rows = heads[:-1], [r.replace("<td></td></tr>", "</tr>") for r in rows]
    return section("Effects to add", table(heads, rows))


def signature(report: dict) -> str:
    """What an unexplained residual looks like."""
    text = report["signature"]
    return section("What the unexplained part looks like", paragraph(text[0].upper() + text[1:])) if text else ""


def next_experiment(report: dict) -> str:
    """What to record to decide what these data could not."""
    text = report["next_experiment"]
    return section("What to record next", paragraph(text[0].upper() + text[1:])) if text else ""


def pictures(diagnosis: Diagnosis, drawn: dict[str, Figure]) -> str:
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


def difference(repaired: Repaired, declared: bool) -> str:
    """The MJCF difference, and what MJCF cannot say; whether effects were declared before."""
    kinds = {"+": "add", "-": "cut", "@": "at"}
    lines = [
        f'<span class="{kinds.get(line[0], "")}">{escape(line)}</span>' if line[:1] in kinds else f"<span>{line}</span>"
        for line in (escape(d) if d[:1] not in kinds else d for d in repaired.difference()[2:])
    ]
    parts = [f'<div class="wide"><pre>{"".join(lines)}</pre></div>'] if lines else []
    if repaired.unsaid:
        names = listing(meaning(e.name, e.target) for e in repaired.unsaid).replace(" or ", " and ")
        parts.append(paragraph(f"MJCF has no words for {names}: in effects.yaml alone, not in patched.xml."))
    if not parts:
        return ""
    if lines:
        note = "As in patched.xml" + (", effects declared before included." if declared else ".")
        parts.append(paragraph(note, "small"))
    return section("Change of the model (MJCF)", *parts)


def candidates(diagnosis: Diagnosis) -> str:
    """Everything tried, ranked in each round, and why it lost."""
    tried = sorted(diagnosis.tried, key=lambda t: (t.round, -t.score))
    kept = {(e["effect"], e["target"], *e["parameters"]) for e in diagnosis.report["effects"]}
    rows, last = [], None
    for t in tried:
        if t.round != last:
            rows.append(f'<tr class="round"><td colspan="4">Round {t.round + 1}</td></tr>')
            last = t.round
        rows.append(candidate_row(t, kept))
    if not rows:
        return ""
    heads = ("candidate", "#score", "#held-out gain", "why it lost")
    parts = [table(heads, rows[:SHOWN])]
    if len(rows) > SHOWN:
        more = table(heads, rows[SHOWN:])
        parts.append(f"<details><summary>{len(rows) - SHOWN} more</summary>\n{more}\n</details>")
    caption = (
        "Score: squared error that a small dose of the effect explains, in units of the noise. Held-out gain: what a "
        "refit with it takes off the mean squared error of held-out windows; only the best of each round are refitted."
    )
    return section("Candidates", *parts, paragraph(caption, "small"))


def candidate_row(t: Tried, kept: set[tuple[str, ...]]) -> str:
    """One candidate in one round."""
    c = t.candidate
    fixed = "".join(f", {name} {number(v)}" for name, v in c.fixed if isinstance(v, float) and c.size > 1)
    name = f"{meaning(c.kind.name, c.target)} ({', '.join(c.names)}{fixed})"
    gain = "#-" if t.gain != t.gain else f"#{number(t.gain)} ± {number(t.gain_error, 2)}"
    if t.rejected_because:
        return row(name, f"#{number(t.score)}", gain, t.rejected_because)
    fate = "accepted" if (c.kind.name, c.target, *c.names) in kept else "accepted, later needless: left out again"
    return row(name, f"#{number(t.score)}", gain, fate, kind="accepted" if fate == "accepted" else "")


def settings(diagnosis: Diagnosis, model_name: str, data_name: str) -> str:
    """Where the numbers come from."""
    report, sim = diagnosis.report, diagnosis.sim
    error = report["error"]
    dt = float(np.median(np.diff(sim.data[0].time)))
    declared = ", ".join(meaning(e.name, e.target) for e in diagnosis.declared)
    rows = [
        ("model", f"{model_name}; degrees of freedom: {sim.model.nv}, actuators: {sim.model.nu}"),
        ("recordings", f"{data_name}; episodes: {len(sim.data)}, steps: {sum(map(len, sim.data))} of {number(dt)} s"),
        ("fitted on", episodes(error["fit_episodes"])),
        ("judged on", episodes(error["held_out_episodes"])),
        ("windows", f"{number(error['horizon_s'])} s; {len(diagnosis.held_out)} held out"),
        ("compared", "positions and velocities" if sim.velocities else "positions; velocities are their slopes"),
        ("declared effects", declared or "none"),
        ("runtime", f"{number(report['runtime_s'])} s, {sim.calls} batches of simulations"),
        ("made with", f"MuJoCo {mujoco.__version__}; schema {report['schema']}"),
    ]
    return section("Settings", table(("", ""), (row(*r) for r in rows)))
