"""What was found missing in a source by the target's images: effects, residuals, the sensor's errors."""

from __future__ import annotations

from html import escape

import mujoco

from idapt_pl.effects.wording import format_estimate, format_number, phrase_at, unit_at
from idapt_pl.report.html import paragraph, row, table
from idapt_pl.report.run_figures import forecast_figure, styled_svg


def found_effects_section(sought: dict, model: mujoco.MjModel) -> str:
    """What was found, what it removes of the residual, and what that was read with; empty where nothing was sought.

    Args:
        sought: as in ``effects.json``.
        model: of the source.
    """
    if not sought:
        return ""
    rows = effect_rows(sought, model)
    heads = ("effect looked for and found", "parameter", "#estimate", "#95 % interval", "unit", "")
    none = "Effects that the source lacks were looked for in the target's images; none was found."
    parts = [
        residual_paragraph(sought),
        table(heads, rows) if rows else paragraph(none),
        forecast_picture(sought),
        channel_details(sought),
    ]
    return "".join(parts)


def forecast_picture(sought: dict) -> str:
    """An episode of the target and what forecasts it."""
    if "example" not in sought:
        return ""
    told = (
        "A typical episode of the target as the sensor reads its images, and what the source makes of the same "
        "commands from several resets, seen through G and read by the same sensor. The joints shown are those of "
        "which the source is furthest off."
    )
    shown = f'<div class="wide">{styled_svg(forecast_figure(sought["example"]))}</div>'
    return f"<figure>{shown}<figcaption>{escape(told)}</figcaption></figure>"


def residual_paragraph(effects: dict) -> str:
    """How far the source is from the target, before and after the effects."""
    if "before" not in effects:
        return ""
    before, after, excess = (format_number(effects[k]) for k in ("before", "after", "excess"))
    if effects.get("forecasts"):
        found = f", and {after} with the effects added" if effects["effects"] else ""
        return paragraph(
            "How fast things move cannot be told from these images, so effects are judged by forecasts: the target's "
            "commands are played in the source from resets, and its images are seen through G and read as the target's "
            f"are. The energy score of what is read of the target is {before}{found} (less is better; "
            f"{format_number(effects['before'] / effects['excess'])} where the source forecasts itself)."
        )
    then = f", and {after} times with all the effects found" if effects["estimates"] else ""
    return paragraph(
        f"Replaying the target's actions, the source is {before} times the sensor's noise away from what the target's "
        f"images show (held-out episodes){then}. In the channel that stands out most it is {excess} times as far off "
        "as where it replays its own actions."
    )


def effect_rows(effects: dict, model: mujoco.MjModel, kept: str = "added to the source") -> list[str]:
    """A row for each parameter of each effect, and what became of it; ``kept`` is what is said of believed ones."""
    believed, rows = {(e["effect"], e["target"]) for e in effects.get("effects", [])}, []
    left_out = effects.get("left_out", [])
    for e in (*effects.get("estimates", []), *left_out):
        known = (e["effect"], e["target"]) in believed
        doubt = "too little goes with it" if e in left_out else "it may be an error of the estimator"
        doubt = "forecasts are not surely better" if effects.get("forecasts") else doubt
        for name, p in e["parameters"].items():
            value, interval = format_estimate(p["estimate"], p["ci95"])
            fate = kept if known else f"not believed: {doubt}"
            what = (phrase_at(e["effect"], e["target"]), name, f"#{value}", f"#{interval or '-'}")
            rows.append(row(*what, unit_at(model, e["target"], p["unit"]), fate, kind="accepted" if known else ""))
    return rows


def channel_details(effects: dict) -> str:
    """Residuals and the sensor's error, channel by channel, folded away."""
    if not effects.get("target"):
        return ""
    heads = ("channel", "unit", "#sensor", "#target, before", "#after", "#control")
    rows = []
    for name, error in effects["target"].items():
        control = effects["control"].get(name)
        values = (error["noise"], error["before"], error["after"], control and control["before"])
        rows.append(row(name, error["unit"], *("#-" if v is None else f"#{format_number(v)}" for v in values)))
    unread = effects.get("unread", {})
    shares = ", ".join(f"{format_number(100 * share)} % of the {of}'s" for of, share in unread.items())
    left_out = f" Frames unlike those it learned from were left out: {shares}." if shares else ""
    gain = effects.get("unknown_gain")
    allowed = (
        f" Intervals allow for readings that are {format_number(100 * gain)} % too large or small." if gain else ""
    )
    if error := effects.get("unknown_error"):
        allowed = (
            f" Intervals allow for {format_number(100 * error)} % by which G and the sensor may mislead an estimate."
        )
    does = "forecasts" if effects.get("forecasts") else "replays"
    told = paragraph(
        "Root mean square errors. The sensor is what estimates states from images; its error is measured on images of "
        f"the source, as G shows them, whose states are known. Control: the source {does} these, before any effect."
        + left_out
        + allowed,
        "small",
    )
    title = "Channel by channel, and how well the images are read"
    return f"<details><summary>{title}</summary>\n{table(heads, rows)}{told}</details>"
