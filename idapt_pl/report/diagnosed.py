"""The files of a diagnosis by forecasts: report.json, report.html, patched.xml, effects.yaml and TensorBoard's."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import mujoco
from torch.utils.tensorboard import SummaryWriter

from idapt_pl.diagnosis.page import CSS, TONES, difference, paragraph, row, section, table
from idapt_pl.diagnosis.repaired import Repaired, repair
from idapt_pl.diagnosis.report import write_model
from idapt_pl.diagnosis.words import lacking, meaning, number, undecided
from idapt_pl.discovery.forecasts import EPISODES, STEPS
from idapt_pl.domains import Domain, Effect, effect_from_dict
from idapt_pl.files import write_atomically, write_json, write_yaml
from idapt_pl.report.effects import channels, found, picture, residuals
from idapt_pl.report.figures import forecasts

HEADLINES = {
    "effects_found": "Found what the source lacks",
    "no_missing_effect": "No effect makes forecasts surely better",
}


def report_of(sought: dict, declared: Sequence[Effect], runtime: float) -> dict:
    """As in report.json.

    Args:
        sought: as of :func:`idapt_pl.discovery.discover`, by forecasts.
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
            "metric": f"energy score of forecasts through images, the first {STEPS} control steps of an episode",
            "unit": "spreads of what is read",
            "split": f"at most {EPISODES} episodes; an effect is accepted on resets that it was not chosen by",
            "horizon_s": round(STEPS * dt, 6),
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


def verdict_in_words(report: dict, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first."""
    error = report["error"]
    level = f"{number(error['noise_floor'])} where the source forecasts itself"
    if not report["effects"]:
        return [
            "None of the effects tried makes what is read of these images better to forecast than chance would.",
            f"The energy score of the source's forecasts is {number(error['before'])}, and {level}; the difference may "
            "be what G and the sensor get wrong in these images, or an effect that was not tried.",
        ]
    before, after, them = (
        number(error["before"]),
        number(error["after"]),
        "it" if len(report["effects"]) == 1 else "them",
    )
    return [
        lacking(report, model),
        f"With {them}, the energy score of forecasts is {after} instead of {before} (less is better; {level}).",
        *undecided(report),
    ]


def write_diagnosed(
    sought: dict, source: Domain, declared: Sequence[Effect], folder: Path, names: tuple[str, str], runtime: float
) -> dict:
    """Write everything that a diagnosis by forecasts leaves behind.

    Args:
        sought: as of :func:`idapt_pl.discovery.discover`, by forecasts.
        source: as it was, without ``declared``.
        declared: effects given beforehand.
        folder: made if it is not there; also TensorBoard's log folder.
        names: of the run and the recordings, for the page's title.
        runtime: s.

    Returns:
        The report, as in report.json.
    """
    model, report = source.compile(), report_of(sought, declared, runtime)
    effects = [effect_from_dict(e) for e in sought["effects"]]
    write_json(folder / "report.json", report)
    write_yaml(folder / "effects.yaml", sought["effects"])
    repaired = repair(source.spec(), (*declared, *effects), folder)
    html = page(sought, report, repaired, model, names)
    write_atomically(folder / "report.html", lambda path: path.write_text(html, encoding="utf-8"))
    log_to_tensorboard(folder, sought, report, model)
    write_atomically(folder / "patched.xml", lambda path: write_model(path, repaired.patched))
    return report


def log_to_tensorboard(folder: Path, sought: dict, report: dict, model: mujoco.MjModel) -> None:
    """Scores, the verdict and the picture; events of an earlier diagnosis are removed."""
    for old in folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(folder) as writer:
        for name in ("before", "after", "noise_floor", "removed_share"):
            writer.add_scalar(f"error/{name}", report["error"][name], 0)
        writer.add_text("verdict", " ".join(verdict_in_words(report, model)), 0)
        writer.add_figure("forecasts", forecasts(sought["example"]), 0)


def page(sought: dict, report: dict, repaired: Repaired, model: mujoco.MjModel, names: tuple[str, str]) -> str:
    """The whole page."""
    (first, *more), title = verdict_in_words(report, model), HEADLINES[report["verdict"]]
    heads = ("effect looked for and found", "parameter", "#estimate", "#95 % interval", "unit", "")
    rows = found(sought, model, "in patched.xml")
    parts = [
        f'<header>\n<p class="small">{escape(" against ".join(names))}</p>\n<h1>{escape(title)}</h1>\n'
        + "\n".join([paragraph(first, "lead"), *map(paragraph, more)])
        + "\n</header>",
        section("Effects", table(heads, rows)) if rows else "",
        section("Forecasts", residuals(sought), picture(sought), channels(sought)),
        difference(repaired, bool(report["declared"])),
        settings(report, names),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}: {escape(names[0])}</title>\n"
        f"<style>{CSS}:root {{ --tone: {TONES[report['verdict']]}; }}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(p for p in parts if p)
        + "\n</main>\n</body>\n</html>\n"
    )


def settings(report: dict, names: tuple[str, str]) -> str:
    """Where the numbers come from."""
    error = report["error"]
    rows = [
        ("run", names[0]),
        ("recordings", names[1]),
        ("judged by", f"{error['metric']} ({number(error['horizon_s'])} s), in {error['unit']}"),
        ("episodes", error["split"]),
        ("declared effects", ", ".join(meaning(e["effect"], e["target"]) for e in report["declared"]) or "none"),
        ("runtime", f"{number(report['runtime_s'])} s"),
        ("made with", f"MuJoCo {mujoco.__version__}; schema {report['schema']}"),
    ]
    return section("Settings", table(("", ""), (row(*r) for r in rows)))
