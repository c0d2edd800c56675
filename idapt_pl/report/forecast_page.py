"""The files of a diagnosis by forecasts: report.json, report.html, patched.xml, effects.yaml and TensorBoard's."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import mujoco
from torch.utils.tensorboard import SummaryWriter

from idapt_pl.diagnosis.repaired import RepairedModel, repair_model
from idapt_pl.diagnosis.result import EffectEstimate
from idapt_pl.effects import Domain, Effect, effect_from_dict
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.files import write_atomically, write_json, write_yaml
from idapt_pl.image_diagnosis.forecasts import FORECAST_EPISODES, FORECAST_STEPS
from idapt_pl.report.diagnosis_files import write_loadable_model
from idapt_pl.report.diagnosis_page import TONES, model_difference_section
from idapt_pl.report.diagnosis_wording import lacking_sentence, undecided_sentences
from idapt_pl.report.found_effects import channel_details, effect_rows, forecast_picture, residual_paragraph
from idapt_pl.report.html import CSS, paragraph, row, section, table
from idapt_pl.report.run_figures import forecast_figure

FORECAST_HEADLINES = {
    "effects_found": "Found what the source lacks",
    "no_missing_effect": "No effect makes forecasts surely better",
}


def forecast_report(sought: dict, declared: Sequence[Effect], runtime: float) -> dict:
    """As in report.json.

    Args:
        sought: as of :func:`idapt_pl.image_diagnosis.discover`, by forecasts.
        declared: effects given beforehand.
        runtime: s.
    """
    believed = {(e["effect"], e["target"]) for e in sought["effects"]}
    estimates = [e | {"known": (e["effect"], e["target"]) in believed} for e in sought["estimates"]]
    dt = sought["example"]["dt"]
    return {
        "schema": "idapt.diagnosis/1",
        "verdict": "effects_found" if sought["effects"] else "no_missing_effect",
        "error": {
            "metric": f"energy score of forecasts through images, the first {FORECAST_STEPS} control steps of an episode",
            "unit": "spreads of what is read",
            "split": f"at most {FORECAST_EPISODES} episodes; an effect is accepted on resets that it was not chosen by",
            "horizon_s": round(FORECAST_STEPS * dt, 6),
            "before": sought["before"],
            "after": sought["after"],
            "noise_floor": sought["before"] / sought["excess"],
            "ceiling": None,
            "removed_share": sought["explained"],
            "per_channel": sought["target"],
        },
        "effects": [{k: v for k, v in e.items() if k != "known"} for e in estimates if e["known"]],
        "declared": [e.to_dict() for e in declared],
        "candidates": [
            {
                "effect": e["effect"],
                "target": e["target"],
                "parameters": {name: p["estimate"] for name, p in e["parameters"].items()},
                "score": e["error_after"],
                "held_out_gain": None,
                "rejected_because": "forecasts from other resets are not surely better with it",
            }
            for e in estimates
            if not e["known"]
        ],
        "signature": "",
        "next_experiment": "",
        "runtime_s": round(runtime, 2),
    }


def forecast_verdict(report: dict, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first."""
    error = report["error"]
    level = f"{format_number(error['noise_floor'])} where the source forecasts itself"
    if not report["effects"]:
        return [
            "None of the effects tried makes what is read of these images better to forecast than chance would.",
            f"The energy score of the source's forecasts is {format_number(error['before'])}, and {level}; the difference may "
            "be what G and the sensor get wrong in these images, or an effect that was not tried.",
        ]
    before, after, them = (
        format_number(error["before"]),
        format_number(error["after"]),
        "it" if len(report["effects"]) == 1 else "them",
    )
    effects = [EffectEstimate.from_dict(e) for e in report["effects"]]
    return [
        lacking_sentence(effects, model),
        f"With {them}, the energy score of forecasts is {after} instead of {before} (less is better; {level}).",
        *undecided_sentences(effects),
    ]


def write_forecast_diagnosis(
    sought: dict, source: Domain, declared: Sequence[Effect], folder: Path, names: tuple[str, str], runtime: float
) -> dict:
    """Write everything that a diagnosis by forecasts leaves behind.

    Args:
        sought: as of :func:`idapt_pl.image_diagnosis.discover`, by forecasts.
        source: as it was, without ``declared``.
        declared: effects given beforehand.
        folder: made if it is not there; also TensorBoard's log folder.
        names: of the run and the recordings, for the page's title.
        runtime: s.

    Returns:
        The report, as in report.json.
    """
    model, report = source.compile(), forecast_report(sought, declared, runtime)
    effects = [effect_from_dict(e) for e in sought["effects"]]
    write_json(folder / "report.json", report)
    write_yaml(folder / "effects.yaml", sought["effects"])
    repaired = repair_model(source.spec(), (*declared, *effects), folder)
    html = forecast_page(sought, report, repaired, model, names)
    write_atomically(folder / "report.html", lambda path: path.write_text(html, encoding="utf-8"))
    log_forecast_diagnosis(folder, sought, report, model)
    write_atomically(folder / "patched.xml", lambda path: write_loadable_model(path, repaired.patched))
    return report


def log_forecast_diagnosis(folder: Path, sought: dict, report: dict, model: mujoco.MjModel) -> None:
    """Scores, the verdict and the picture; events of an earlier diagnosis are removed."""
    for old in folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(folder) as writer:
        for name in ("before", "after", "noise_floor", "removed_share"):
            writer.add_scalar(f"error/{name}", report["error"][name], 0)
        writer.add_text("verdict", " ".join(forecast_verdict(report, model)), 0)
        writer.add_figure("forecasts", forecast_figure(sought["example"]), 0)


def forecast_page(
    sought: dict, report: dict, repaired: RepairedModel, model: mujoco.MjModel, names: tuple[str, str]
) -> str:
    """The whole page."""
    (first, *more), title = forecast_verdict(report, model), FORECAST_HEADLINES[report["verdict"]]
    heads = ("effect looked for and found", "parameter", "#estimate", "#95 % interval", "unit", "")
    rows = effect_rows(sought, model, "in patched.xml")
    parts = [
        f'<header>\n<p class="small">{escape(" against ".join(names))}</p>\n<h1>{escape(title)}</h1>\n'
        + "\n".join([paragraph(first, "lead"), *map(paragraph, more)])
        + "\n</header>",
        section("Effects", table(heads, rows)) if rows else "",
        section("Forecasts", residual_paragraph(sought), forecast_picture(sought), channel_details(sought)),
        model_difference_section(repaired, bool(report["declared"])),
        forecast_settings(report, names),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}: {escape(names[0])}</title>\n"
        f"<style>{CSS}:root {{ --tone: {TONES[report['verdict']]}; }}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(p for p in parts if p)
        + "\n</main>\n</body>\n</html>\n"
    )


def forecast_settings(report: dict, names: tuple[str, str]) -> str:
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
