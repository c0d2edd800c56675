"""The files of a diagnosis by forecasts: report.json, report.html, patched.xml, effects.yaml and TensorBoard's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
from torch.utils.tensorboard import SummaryWriter

from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.answer.result import DiagnosisResult, Verdict
from idapt_pl.effects import Domain, Effect
from idapt_pl.files import write_atomically, write_json, write_yaml
from idapt_pl.image_diagnosis import ImageDiagnosis
from idapt_pl.image_diagnosis.forecasts import FORECAST_EPISODES, FORECAST_STEPS
from idapt_pl.report.diagnosis_files import write_loadable_model
from idapt_pl.report.forecast_page import forecast_page, forecast_verdict
from idapt_pl.report.run_figures import forecast_figure


def write_forecast_diagnosis(
    diagnosis: ImageDiagnosis,
    source: Domain,
    declared: Sequence[Effect],
    folder: Path,
    names: tuple[str, str],
    runtime: float,
) -> None:
    """Write everything that a diagnosis by forecasts leaves behind.

    Args:
        diagnosis: by forecasts.
        source: as it was, without ``declared``.
        declared: effects given beforehand.
        folder: made if it is not there; also TensorBoard's log folder.
        names: of the run and the recordings, for the page's title.
        runtime: s.
    """
    model, report = source.compile(), forecast_report(diagnosis, declared, runtime)
    write_json(folder / "report.json", report)
    write_yaml(folder / "effects.yaml", [e.to_dict() for e in diagnosis.effects])
    repaired = repair_model(source.spec(), (*declared, *diagnosis.effects), folder)
    html = forecast_page(diagnosis, report, repaired, model, names)
    write_atomically(folder / "report.html", lambda path: path.write_text(html, encoding="utf-8"))
    log_forecast_diagnosis(folder, diagnosis, report, model)
    write_atomically(folder / "patched.xml", lambda path: write_loadable_model(path, repaired.patched))


def log_forecast_diagnosis(folder: Path, diagnosis: ImageDiagnosis, report: dict, model: mujoco.MjModel) -> None:
    """Scores, the verdict and the picture; events of an earlier diagnosis are removed."""
    for old in folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(folder) as writer:
        for name in ("before", "after", "noise_floor", "removed_share"):
            writer.add_scalar(f"error/{name}", report["error"][name], 0)
        writer.add_text("verdict", " ".join(forecast_verdict(diagnosis, model)), 0)
        writer.add_figure("forecasts", forecast_figure(diagnosis.forecast_evidence.example), 0)


def forecast_report(diagnosis: ImageDiagnosis, declared: Sequence[Effect], runtime: float) -> dict:
    """The content of report.json.

    Args:
        diagnosis: by forecasts.
        declared: effects given beforehand.
        runtime: s.
    """
    horizon = FORECAST_STEPS * diagnosis.forecast_evidence.example.dt
    return {
        "schema": DiagnosisResult.SCHEMA,
        "verdict": (Verdict.EFFECTS_FOUND if diagnosis.effects else Verdict.NO_MISSING_EFFECT).value,
        "error": {
            "metric": "energy score of forecasts through images, "
            f"the first {FORECAST_STEPS} control steps of an episode",
            "unit": "spreads of what is read",
            "split": f"at most {FORECAST_EPISODES} episodes; an effect is accepted on resets that it was not chosen by",
            "horizon_s": round(horizon, 6),
            "before": diagnosis.before,
            "after": diagnosis.after,
            "noise_floor": diagnosis.before / diagnosis.excess,
            "ceiling": None,
            "removed_share": diagnosis.explained,
            "per_channel": {name: c.to_dict() for name, c in diagnosis.target.items()},
        },
        "effects": [e.to_dict() for e in diagnosis.believed],
        "declared": [e.to_dict() for e in declared],
        "candidates": [
            {
                "effect": e.effect,
                "target": e.target,
                "parameters": {name: p.estimate for name, p in e.parameters.items()},
                "score": e.error_after,
                "held_out_gain": None,
                "rejected_because": "forecasts from other resets are not surely better with it",
            }
            for e in diagnosis.doubted
        ],
        "signature": "",
        "next_experiment": "",
        "runtime_s": round(runtime, 2),
    }
