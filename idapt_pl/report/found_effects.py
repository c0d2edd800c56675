"""What was found missing in a source by the target's images: effects, residuals, the sensor's errors."""

from __future__ import annotations

import mujoco

from idapt_pl.diagnosis.answer.result import EffectEstimate
from idapt_pl.effects.wording import format_estimate, format_number, phrase_at, unit_at
from idapt_pl.image_diagnosis import ImageDiagnosis
from idapt_pl.image_diagnosis.result import ForecastEvidence, ForecastExample
from idapt_pl.report.html import details, figure, paragraph, row, scrollable, table
from idapt_pl.report.plots import svg
from idapt_pl.report.run_figures import forecast_figure

EFFECT_HEADS = ("effect looked for and found", "parameter", "#estimate", "#95 % interval", "unit", "")


def found_effects_section(diagnosis: ImageDiagnosis, model: mujoco.MjModel) -> str:
    """What was found, what it removes of the residual, and what that was read with; ``model`` is the source's."""
    rows = effect_rows(diagnosis, model)
    none = "Effects that the source lacks were looked for in the target's images; none was found."
    parts = [residual_paragraph(diagnosis), table(EFFECT_HEADS, rows) if rows else paragraph(none)]
    if diagnosis.by_forecasts:
        parts.append(forecast_picture(diagnosis.forecast_evidence.example))
    return "".join([*parts, channel_details(diagnosis)])


def known_start_section(searched: dict) -> str:
    """With what forecasts from known starts are best (``known_start_search.json``); empty if nothing was sought."""
    if not searched:
        return ""
    said = "Every candidate was tried in forecasts of the target's first frames, from where episodes begin. "
    if not searched["parameters"]:
        return paragraph(said + "None makes them better.")
    error, gain = searched["error"], searched["gain"]
    before, after, mean = map(format_number, (error["before"], error["after"], gain["mean"]))
    spread = "in fewer than half of the recordings"
    if gain["standard_error"] is not None:
        spread = f"± {format_number(gain['standard_error'])}, one standard error"
    values = []
    for p in searched["parameters"]:
        sure = "-" if p["log_halfwidth"] is None else f"{format_number(100 * p['log_halfwidth'])} %"
        at = phrase_at(p["effect"], p["target"])
        values.append(row(at, p["parameter"], f"#{format_number(p['after'])}", f"#{sure}"))
    verdict = "So this was added" if searched["effects"] else "That is not enough, and nothing was added"
    said += (
        f"They are best with what the table has: their error falls from {before} to {after} (by {mean} nats, "
        f"{spread}). {verdict}."
    )
    best = table(("effect", "parameter", "#value", "#give or take (95 %)"), values)
    tried = [(t["candidate"], *(f"#{format_number(t[key])}" for key in ("value", "error"))) for t in searched["tried"]]
    heads = ("candidate", "#best of the values tried", "#error")
    return paragraph(said) + best + details("Candidates tried", table(heads, [row(*cells) for cells in tried]))


def forecast_picture(example: ForecastExample) -> str:
    """An episode of the target and what forecasts it."""
    caption = (
        "A typical episode of the target as the sensor reads its images, and what the source makes of the same "
        "commands from several resets, seen through G and read by the same sensor. The joints shown are those of "
        "which the source is furthest off."
    )
    return figure(scrollable(svg(forecast_figure(example))), caption)


def residual_paragraph(diagnosis: ImageDiagnosis) -> str:
    """How far the source is from the target, before and after the effects."""
    before, after, excess = map(format_number, (diagnosis.before, diagnosis.after, diagnosis.excess))
    if diagnosis.by_forecasts:
        found = f", and {after} with the effects added" if diagnosis.effects else ""
        return paragraph(
            "How fast things move cannot be told from these images, so effects are judged by forecasts: the target's "
            "commands are played in the source from resets, and its images are seen through G and read as the target's "
            f"are. The energy score of what is read of the target is {before}{found} (less is better; "
            f"{format_number(diagnosis.before / diagnosis.excess)} where the source forecasts itself)."
        )
    then = f", and {after} times with all the effects found" if diagnosis.estimates else ""
    return paragraph(
        f"Replaying the target's actions, the source is {before} times the sensor's noise away from what the target's "
        f"images show (held-out episodes){then}. In the channel that stands out most it is {excess} times as far off "
        "as where it replays its own actions."
    )


def effect_rows(diagnosis: ImageDiagnosis, model: mujoco.MjModel, believed: str = "added to the source") -> list[str]:
    """A row for each parameter of each effect, and what became of it; ``believed`` is what is said of believed ones."""
    doubt = "forecasts are not surely better" if diagnosis.by_forecasts else "it may be an error of the estimator"
    rows = []
    for e in diagnosis.estimates:
        if diagnosis.is_believed(e):
            rows += parameter_rows(e, model, believed, "accepted")
        else:
            rows += parameter_rows(e, model, f"not believed: {doubt}")
    for e in diagnosis.negligible:
        rows += parameter_rows(e, model, "not believed: too little goes with it")
    return rows


def parameter_rows(e: EffectEstimate, model: mujoco.MjModel, fate: str, kind: str = "") -> list[str]:
    """A row for each parameter of an effect."""
    rows = []
    for name, p in e.parameters.items():
        value, interval = format_estimate(p.estimate, p.ci95)
        what = (phrase_at(e.effect, e.target), name, f"#{value}", f"#{interval or '-'}")
        rows.append(row(*what, unit_at(model, e.target, p.unit), fate, kind=kind))
    return rows


def channel_details(diagnosis: ImageDiagnosis) -> str:
    """Residuals and the sensor's error, channel by channel, folded away."""
    if not diagnosis.target:
        return ""
    heads = ("channel", "unit", "#sensor", "#target, before", "#after", "#control")
    rows = []
    for name, error in diagnosis.target.items():
        control = diagnosis.control.get(name)
        values = (error.noise, error.before, error.after, control.before if control else None)
        rows.append(row(name, error.unit, *("#-" if v is None else f"#{format_number(v)}" for v in values)))
    does = "forecasts" if diagnosis.by_forecasts else "replays"
    note = paragraph(
        "Root mean square errors. The sensor is what estimates states from images; its error is measured on images of "
        f"the source, as G shows them, whose states are known. Control: the source {does} these, before any effect."
        + excluded_sentence(diagnosis)
        + allowance_sentence(diagnosis),
        "small",
    )
    return details("Channel by channel, and how well the images are read", table(heads, rows), note)


def excluded_sentence(diagnosis: ImageDiagnosis) -> str:
    """Which share of the frames was not used; empty where that is not known."""
    excluded = diagnosis.excluded_frames.items()
    shares = ", ".join(f"{format_number(100 * share)} % of the {of}'s" for of, share in excluded)
    return f" Frames unlike those it learned from were left out: {shares}." if shares else ""


def allowance_sentence(diagnosis: ImageDiagnosis) -> str:
    """What intervals allow for beside chance."""
    if isinstance(diagnosis.evidence, ForecastEvidence):
        percent = format_number(100 * diagnosis.evidence.unknown_error)
        return f" Intervals allow for {percent} % by which G and the sensor may mislead an estimate."
    if not diagnosis.evidence.unknown_gain:
        return ""
    percent = format_number(100 * diagnosis.evidence.unknown_gain)
    return f" Intervals allow for readings that are {percent} % too large or small."
