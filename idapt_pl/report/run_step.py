"""The part of a run's report that tells of one grounding step: in words, in pictures, in numbers."""

from __future__ import annotations

import base64

from idapt_pl.appearance import VisualEffects
from idapt_pl.effects.wording import format_number
from idapt_pl.files import verify
from idapt_pl.report.found_effects import found_effects_section, known_start_section
from idapt_pl.report.html import (
    data_uri,
    details,
    figure,
    image,
    paragraph,
    picture_grid,
    picture_row,
    png_uri,
    row,
    section,
    table,
)
from idapt_pl.report.run_pictures import translated_examples
from idapt_pl.report.run_record import RunRecord, StepRecord
from idapt_pl.report.run_wording import format_distance, step_story
from idapt_pl.run import Run
from idapt_pl.run_folder.results import newest_of

PICTURE_WIDTH = 92
"""Of translated frames, pixels of the page."""
EACH = "mean absolute, each"


def step_section(record: RunRecord, step: StepRecord, metric: str, run: Run) -> str:
    """One grounding step: in words, in pictures, in numbers."""
    model = run.worlds.source_domain.compile()
    parts = [paragraph(s) for s in step_story(record, step, metric)]
    if step.settled:
        return section(f"Step {step.k}: nothing left to learn", *parts)
    if step.visual_effects is not None:
        parts.append(visual_effects_section(step.visual_effects))
    if step.diagnosis is not None:
        parts.append(found_effects_section(step.diagnosis, model))
    parts.append(known_start_section(step.searched))
    parts += [step_images(step, run), step_numbers(step, metric)]
    grounded = "G, F" if "dynamics" in step.seconds else "G"
    learned = f"{grounded} and the policy" if step.k else "G, and effects" if step.source_repaired else "G alone"
    return section(f"Step {step.k}: {learned}", *parts, kind="rolled" * step.selection.get("rolled_back", False))


def step_images(step: StepRecord, run: Run) -> str:
    """Source, translation and target; and the policy at work."""
    made = [translated_frames(step, run)]
    clip = step.folder / "policy_in_grounded_and_target.gif"
    if clip.exists():
        shown = image(data_uri(clip.read_bytes(), "gif"), "the policy")
        both = "grounded source (left), target (right; evaluation only)"
        where = both if step.evaluation.get("target") else "grounded source"
        made.append(figure(shown, f"The policy: {where}.", "clip"))
    return picture_row(*made)


def translated_frames(step: StepRecord, run: Run) -> str:
    """Rows of pictures: what the source shows, what G makes of it, and the real target frame most like that."""
    checkpoint = newest_of(step.folder, "visual/final.ckpt")
    if not checkpoint.exists():
        return paragraph("No pictures: G of this step has not been trained yet.", "small")
    try:
        G = run.load_visual(checkpoint)
    except ValueError as error:
        return paragraph(f"No pictures: {error}", "small")
    recordings = (newest_of(step.folder, "source.h5"), step.folder / "target.h5")
    try:
        for path in recordings:
            verify(path)
        examples = translated_examples(*recordings, G)
    except Exception as error:  # what damaged data do to their readers can be anything
        return paragraph(f"No pictures: {error}", "small")
    rows = {
        "source": examples.source,
        "G makes of it": examples.translated,
        "most similar real target frame": examples.target,
    }
    return picture_grid({name: [png_uri(i) for i in images] for name, images in rows.items()}, PICTURE_WIDTH)


def visual_effects_section(found: VisualEffects) -> str:
    """What the first frames of the target's episodes show the source to lack."""
    before, after, floor = map(format_number, (found.before, found.after, found.floor))
    then = (
        f"and {after} from that of the source with the visual effects below"
        if found.estimates
        else "and no visual effect was found that brings them nearer"
    )
    text = paragraph(
        f"The mean first frame of the target's episodes held out is {before} levels (of 255, root mean square) from "
        f"the source's, {then}; noise alone makes {floor}."
    )
    shown = image(data_uri(base64.b64decode(found.picture), "png"), "mean first frames")
    caption = "Mean first frames: source, source with the effects found, target."
    rows = [
        row(e.effect, e.target, name, f"#{format_number(value)}", f"#{format_number(e.std[name])}", e.unit)
        for e in found.estimates
        for name, value in e.estimate.items()
    ]
    heads = ("visual effect found", "where", "what", "#value", "#standard deviation", "unit")
    return text + picture_row(figure(shown, caption, "clip")) + (details("Values", table(heads, rows)) if rows else "")


def state_error_rows(errors: dict, where: str) -> list[str]:
    """How wrong the policy was about the state while it acted."""
    world = {"grounded": "grounded source", "target": "target"}[where]
    readers = {"readings": "read from a stack of frames", "estimates": "after the filter over time"}
    rows = [
        row(f"state error while acting in the {world}, {what}", f"#{', '.join(map(format_number, errors[key]))}", EACH)
        for key, what in readers.items()
        if key in errors
    ]
    if "lost" in errors:
        rows.append(
            row(f"steps in the {world} in which the filter lost the state", f"#{100 * errors['lost']:.1f}", "%")
        )
    return rows


def step_numbers(step: StepRecord, metric: str) -> str:
    """Translation errors and the rest of the evaluation, folded away."""
    if not step.evaluation:
        return ""
    t = step.evaluation["translation"]
    what = "PSNR of G against the target's image of the same state"
    rows = [row(what, f"#{format_number(t['psnr'])}", "dB")] if t else []
    readers = {
        "state_source": "P^S reads off source images",
        "state_translated": "P^T off what G makes of them",
        "state_target": "P^T off target images",
    }
    for key, what in readers.items():
        if key in t:
            rows.append(row(f"state error, {what}", "#" + ", ".join(map(format_number, t[key])), EACH))
    for where in ("grounded", "target"):
        rows += state_error_rows(step.evaluation[where].get("state_errors", {}), where)
    for key, what in {"before": "without F", "after": "with F", "noise_floor": "halves of the target's data"}.items():
        if "residual" in step.evaluation:
            rows.append(
                row(f"residual, {what}", f"#{format_distance(step.evaluation['residual'], key)}", "energy distance")
            )
    if there := step.evaluation["target"]:
        every = there["successes"] or there["returns"]
        rows.append(row(f"{metric} in the target, worst and best episode", f"#{min(every):g} to {max(every):g}", ""))
    note = paragraph("For evaluation only, with source and target put into the same states.", "small") if t else ""
    return details("Errors and returns", table(("what", "#value", "unit"), rows), note)
