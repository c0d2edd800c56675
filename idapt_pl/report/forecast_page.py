"""A diagnosis by forecasts as one HTML page, the verdict on top."""

from __future__ import annotations

import mujoco

from idapt_pl.diagnosis.answer.repaired import RepairedModel
from idapt_pl.diagnosis.answer.result import Verdict
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.image_diagnosis import ImageDiagnosis
from idapt_pl.report.diagnosis_page import TONES, model_difference_section
from idapt_pl.report.diagnosis_wording import lacking_sentence, undecided_sentences
from idapt_pl.report.found_effects import (
    EFFECT_HEADS,
    channel_details,
    effect_rows,
    forecast_picture,
    residual_paragraph,
)
from idapt_pl.report.html import document, header, paragraph, row, section, table

FORECAST_HEADLINES = {
    Verdict.EFFECTS_FOUND: "Found what the source lacks",
    Verdict.NO_MISSING_EFFECT: "No effect makes forecasts surely better",
}


def forecast_verdict(diagnosis: ImageDiagnosis, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first; ``model`` is the source's."""
    before, after = format_number(diagnosis.before), format_number(diagnosis.after)
    level = f"{format_number(diagnosis.before / diagnosis.excess)} where the source forecasts itself"
    if not diagnosis.effects:
        return [
            "None of the effects tried makes what is read of these images better to forecast than chance would.",
            f"The energy score of the source's forecasts is {before}, and {level}; the difference may be what G and "
            "the sensor get wrong in these images, or an effect that was not tried.",
        ]
    them = "it" if len(diagnosis.believed) == 1 else "them"
    return [
        lacking_sentence(diagnosis.believed, model),
        f"With {them}, the energy score of forecasts is {after} instead of {before} (less is better; {level}).",
        *undecided_sentences(diagnosis.believed),
    ]


def forecast_page(
    diagnosis: ImageDiagnosis, report: dict, repaired: RepairedModel, model: mujoco.MjModel, names: tuple[str, str]
) -> str:
    """The whole page."""
    (first, *more), title = forecast_verdict(diagnosis, model), FORECAST_HEADLINES[report["verdict"]]
    rows = effect_rows(diagnosis, model, "in patched.xml")
    forecasts = (
        residual_paragraph(diagnosis),
        forecast_picture(diagnosis.forecast_evidence.example),
        channel_details(diagnosis),
    )
    parts = [
        header(title, paragraph(first, "lead"), *map(paragraph, more), note=" against ".join(names)),
        section("Effects", table(EFFECT_HEADS, rows)) if rows else "",
        section("Forecasts", *forecasts),
        model_difference_section(repaired, bool(report["declared"])),
        forecast_settings_section(report, names),
    ]
    return document(f"{title}: {names[0]}", parts, TONES[report["verdict"]])


def forecast_settings_section(report: dict, names: tuple[str, str]) -> str:
    """Where the numbers come from."""
    error = report["error"]
    rows = [
        ("run", names[0]),
        ("recordings", names[1]),
        ("judged by", f"{error['metric']} ({format_number(error['horizon_s'])} s), in {error['unit']}"),
        ("episodes", error["split"]),
        ("declared effects", ", ".join(phrase_at(e["effect"], e["target"]) for e in report["declared"]) or "none"),
        ("runtime", f"{format_number(report['runtime_s'])} s"),
        ("made with", f"MuJoCo {mujoco.__version__}; schema {report['schema']}"),
    ]
    return section("Settings", table(("", ""), (row(*r) for r in rows)))
