"""The report of a run: no scripts, nothing fetched, the outcome on top, then the story step by step."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path

from idapt_pl.effects.wording import format_number
from idapt_pl.files import write_atomically
from idapt_pl.report.found_effects import found_effects_section
from idapt_pl.report.html import CSS, paragraph, row, section, table
from idapt_pl.report.run_figures import returns_figure
from idapt_pl.report.run_pictures import data_uri, png, translated_examples
from idapt_pl.report.run_record import RunRecord, StepRecord, read_run_record
from idapt_pl.run import Run
from idapt_pl.stages.rollback import RollbackDecision

RUN_CSS = """
:root { --tone: #1d6fa5; }
.tiles { display: flex; flex-wrap: wrap; gap: .6rem; margin: .8rem 0; }
.tile { flex: 1 1 8rem; background: #f4f5f7; border-radius: 8px; padding: .5rem .75rem; }
.tile b { display: block; font-size: 1.35rem; font-variant-numeric: tabular-nums; }
.tile.best { background: #e6f1f8; }
.look { display: flex; flex-wrap: wrap; gap: 1.25rem; margin: .6rem 0; }
.grid { display: grid; gap: 4px; align-content: start; align-items: center; font-size: .87rem; color: #62666d; }
.look img { image-rendering: pixelated; border-radius: 4px; display: block; }
.grid img { width: 92px; }
.clip { width: 276px; } .clip img { width: 100%; }
.rolled { border-left: 6px solid #b4452c; }
"""


def write_run_report(run: Run, path: Path | None = None) -> Path:
    """Write ``report.html`` of a run, finished or not, from its folder; nothing is simulated. Returns its path."""
    path = path or run.folder / "report.html"
    text = run_page(read_run_record(run.folder), run)
    write_atomically(path, lambda temporary: temporary.write_text(text))
    return path


def run_page(record: RunRecord, run: Run) -> str:
    """The whole page."""
    metric = run.worlds.task.metric
    parts = [outcome_header(record, metric), unfinished(record), chart(record, metric)]
    parts += [step_section(record, step, metric, run) for step in record.steps]
    parts += [times_section(record), ledger_section(record), run_settings(record)]
    title = escape(f"{record.config['task']}: source to {record.config['target']}, seed {record.config['seed']}")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{CSS}{RUN_CSS}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(p for p in parts if p)
        + "\n</main>\n</body>\n</html>\n"
    )


# --- the outcome ------------------------------------------------------------------------------------


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
    return f"Visual grounding{', source repaired' if repaired(step) else ' only'}"


def repaired(step: StepRecord) -> bool:
    """Whether effects were added to the source in it."""
    return any(found.get("effects") for found in (step.looks, step.effects))


def outcome_header(record: RunRecord, metric: str) -> str:
    """The headline, and the numbers that matter."""
    c, last = record.config, record.evaluated[-1:]
    head = "No step has been evaluated yet"
    if last:
        head = f"{metric.capitalize()} in the target: {format_score(last[0].evaluation['target']['mean'], metric)}"
        if record.direct_transfer:
            head += f", where direct transfer has {format_score(record.direct_transfer['mean'], metric)}"
    tiles = [tile("direct transfer", record.direct_transfer, metric)]
    tiles += [tile(step_name(s).lower(), s.evaluation["target"], metric, s in last) for s in record.evaluated]
    tiles += [tile("oracle", record.oracle, metric, missing="not trained")]
    used = max((s.interactions for s in record.steps), default=0)
    tiles.append(f'<div class="tile"><b>{used:,}</b>target interactions</div>')
    p = record.provenance
    made = [
        p.get("started", "date unknown")[:10],
        f"commit {(p.get('git_commit') or 'unknown')[:10]}{'+dirty' * str(p.get('git_commit')).endswith('+dirty')}",
        f"idapt {p.get('versions', {}).get('idapt', '?')}",
        str(p.get("device", "device unknown")),
    ]
    but = " but the oracle" if record.oracle else ""
    return (
        f'<header>\n<p class="small">{escape(c["task"])}, source to {escape(c["target"])}, seed {c["seed"]}; '
        f'{escape(", ".join(made))}</p>\n<h1>{escape(head)}</h1>\n<div class="tiles">{"".join(tiles)}</div>\n'
        + paragraph(
            f"The {metric} in the target is for evaluation only: nothing in the run{but} was trained or selected on "
            "it. The method saw the target's images and its own actions.",
            "small",
        )
        + "\n</header>"
    )


def tile(name: str, result: dict, metric: str, best: bool = False, missing: str = "not measured") -> str:
    """One headline number."""
    value = format_result(result, metric) if result else missing
    return f'<div class="tile{" best" * best}"><b>{escape(value)}</b>{escape(name)}</div>'


def unfinished(record: RunRecord) -> str:
    """What is missing, and how to get it."""
    parts = []
    if not record.finished:
        done = len(record.evaluated)
        parts.append(
            f"The run has not ended: {done} of {record.planned + 1} steps are done (step 0 included). "
            f"To go on where it stopped: idapt fit --config {record.run / 'config.yaml'}"
        )
    if record.unreadable:
        parts.append(f"These files cannot be read and are left out: {', '.join(record.unreadable)}.")
    return section("What is missing", *map(paragraph, parts)) if parts else ""


def chart(record: RunRecord, metric: str) -> str:
    """Returns against what they cost."""
    if not record.evaluated:
        return ""
    caption = "Every point is a policy, at the target interactions that had been used to make it. "
    caption += (
        "The oracle's own are in the ledger below." if record.oracle else "There is no oracle; --oracle true adds it."
    )
    picture = f'<div class="wide">{returns_figure(record, metric)}</div>'
    return section(
        "Against target interactions", f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"
    )


# --- a step -----------------------------------------------------------------------------------------


def step_section(record: RunRecord, step: StepRecord, metric: str, run: Run) -> str:
    """One grounding step: in words, in pictures, in numbers."""
    model = run.worlds.source_domain.compile()
    parts = [paragraph(s) for s in step_story(record, step, metric)]
    parts += [
        visual_effects_section(step),
        found_effects_section(step.effects, model),
        step_images(step, run),
        step_numbers(step, metric),
    ]
    title = f"Step {step.k}: {'G, F and the policy' if step.k else 'G, and effects' if repaired(step) else 'G alone'}"
    made = section(title, *(p for p in parts if p))
    return made.replace("<section>", '<section class="rolled">') if step.selection.get("rolled_back") else made


def spread(residual: dict, key: str) -> str:
    """An energy distance and, where it was measured on several rollouts, their standard deviation."""
    std = residual.get(f"{key}_std")
    return format_number(residual[key]) + (f" ± {format_number(std)}" if std is not None else "")


def step_story(record: RunRecord, step: StepRecord, metric: str) -> list[str]:
    """What happened in a step, in sentences."""
    told = []
    if not step.evaluation:
        stages = ", ".join(step.seconds) or "nothing"
        return [f"This step did not end: there is no evaluation. Finished in it: {stages}."]
    before = [record.direct_transfer, *(s.evaluation["target"] for s in record.evaluated if s.k < step.k)][-1]
    now = f"{metric.capitalize()} in the target: {format_result(step.evaluation['target'], metric)}"
    now += f", {format_score(before['mean'], metric)} before" if before else ""
    told.append(f"{now}; in the grounded source: {format_score(step.evaluation['grounded']['mean'], metric)}.")
    if residual := step.evaluation.get("residual"):
        which = "the F that was gone back to" if step.selection.get("rolled_back") else "F"
        told.append(
            f"With {which}, the grounded source moves {spread(residual, 'after')} away from the target, without it "
            f"{spread(residual, 'before')}; two halves of the target's own data are {format_number(residual['noise_floor'])} "
            "apart (energy distance of transitions, ± the standard deviation over rollouts)."
        )
    psnr = step.evaluation["translation"]["psnr"]
    told[0] += f" What G draws is {format_number(psnr)} dB (PSNR) from the target's image of the same state."
    if step.training.get("kept") == "before":
        before, after = (format_score(step.training[f"trial_{k}"], metric) for k in ("before", "after"))
        told.append(
            f"Training made the policy worse in the grounded source ({metric} {before} before, {after} after): it was "
            "put back."
        )
    if step.selection:
        told.append(RollbackDecision.from_dict(step.selection).sentence + ".")
    return told


def step_images(step: StepRecord, run: Run) -> str:
    """Source, translation and target; and the policy at work."""
    made = [translated_frames(step, run)]
    clip = step.folder / "policy_in_grounded_and_target.gif"
    if clip.exists():
        uri = data_uri(clip.read_bytes(), "gif")
        caption = "The policy: grounded source (left), target (right; evaluation only)."
        made.append(
            f'<figure class="clip"><img src="{uri}" alt="the policy"><figcaption>{caption}</figcaption></figure>'
        )
    return f'<div class="look">{"".join(m for m in made if m)}</div>'


def translated_frames(step: StepRecord, run: Run) -> str:
    """Rows of pictures: what the source shows, what G makes of it, and the real target frame most like that."""
    checkpoint = step.folder / "visual" / "final.ckpt"
    if not checkpoint.exists():
        return paragraph("No pictures: G of this step has not been trained yet.", "small")
    try:
        G = run.load_visual(checkpoint)
    except Exception as error:  # what a damaged checkpoint raises can be anything
        return paragraph(f"No pictures: {checkpoint} cannot be loaded ({type(error).__name__}: {error}).", "small")
    try:
        seen = translated_examples(step.folder / "source.h5", step.folder / "target.h5", G)
    except (ValueError, OSError, KeyError) as error:
        return paragraph(f"No pictures: {error}", "small")
    rows = {"source": seen.source, "G makes of it": seen.translated, "most similar real target frame": seen.target}
    cells = "".join(
        f"<span>{name}</span>" + "".join(f'<img src="{png(i)}" alt="{name}">' for i in images)
        for name, images in rows.items()
    )
    return f'<div class="grid" style="grid-template-columns: 6.5rem repeat({len(seen.source)}, 92px)">{cells}</div>'


def visual_effects_section(step: StepRecord) -> str:
    """What the first frames of the target's episodes show the source to lack."""
    if not step.looks:
        return ""
    before, after, floor = (format_number(step.looks[k]) for k in ("before", "after", "floor"))
    then = (
        f"and {after} from that of the source with the visual effects below"
        if step.looks["estimates"]
        else ("and no visual effect was found that brings them nearer")
    )
    told = paragraph(
        f"The mean first frame of the target's episodes held out is {before} levels (of 255, root mean square) from "
        f"the source's, {then}; noise alone makes {floor}."
    )
    uri = f"data:image/png;base64,{step.looks['picture']}"
    caption = "Mean first frames: source, source with the effects found, target."
    picture = (
        f'<figure class="clip"><img src="{uri}" alt="mean first frames"><figcaption>{caption}</figcaption></figure>'
    )
    rows = [
        row(e["effect"], e["target"], name, f"#{format_number(value)}", f"#{format_number(e['std'][name])}", e["unit"])
        for e in step.looks["estimates"]
        for name, value in e["estimate"].items()
    ]
    heads = ("visual effect found", "where", "what", "#value", "#standard deviation", "unit")
    values = f"<details><summary>Values</summary>\n{table(heads, rows)}</details>" if rows else ""
    return told + f'<div class="look">{picture}</div>' + values


def step_numbers(step: StepRecord, metric: str) -> str:
    """Translation errors and the rest of the evaluation, folded away."""
    if not step.evaluation:
        return ""
    t = step.evaluation["translation"]
    rows = [row("PSNR of G against the target's image of the same state", f"#{format_number(t['psnr'])}", "dB")]
    readers = {
        "state_source": "P^S reads off source images",
        "state_translated": "P^T off what G makes of them",
        "state_target": "P^T off target images",
    }
    for key, what in readers.items():
        if key in t:
            rows.append(row(f"state error, {what}", "#" + ", ".join(map(format_number, t[key])), "mean absolute, each"))
    for key, what in {"before": "without F", "after": "with F", "noise_floor": "halves of the target's data"}.items():
        if "residual" in step.evaluation:
            rows.append(row(f"residual, {what}", f"#{spread(step.evaluation['residual'], key)}", "energy distance"))
    every = step.evaluation["target"]["successes"] or step.evaluation["target"]["returns"]
    rows.append(row(f"{metric} in the target, worst and best episode", f"#{min(every):g} to {max(every):g}", ""))
    note = paragraph("For evaluation only, with source and target put into the same states.", "small")
    return f"<details><summary>Errors and returns</summary>\n{table(('what', '#value', 'unit'), rows)}{note}</details>"


# --- the rest ---------------------------------------------------------------------------------------


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


def run_settings(record: RunRecord) -> str:
    """How to make the run again."""
    p = record.provenance
    versions = ", ".join(f"{k} {v}" for k, v in p.get("versions", {}).items())
    commits = dict.fromkeys([p.get("git_commit"), *(r.get("git_commit") for r in p.get("resumed", []))])
    rows = [
        row("task", f"{record.config['task']}, target {record.config['target']}, seed {record.config['seed']}"),
        row("started", p.get("started", "unknown: run.json is missing")),
        row("commits", ", ".join(str(c) for c in commits)),
        row("machine", f"{p.get('device', '?')}; {p.get('cpu', '?')}; {p.get('platform', '?')}"),
        row("versions", f"python {p.get('python', '?')}, {versions}"),
    ]
    config = json.dumps(record.config["schedule"], indent=2)
    folded = f"<details><summary>Schedule</summary><pre>{escape(config)}</pre></details>"
    note = paragraph("The complete config is config.yaml in the run folder.", "small")
    return section("Settings", table(("", ""), rows), folded, note)
