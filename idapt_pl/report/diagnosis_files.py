"""The files of a diagnosis: report.json, report.html, patched.xml, effects.yaml and TensorBoard's."""

from __future__ import annotations

from pathlib import Path

import mujoco
from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter

from idapt_pl.deployment_faults import FaultReport
from idapt_pl.diagnosis.repaired import repair_model
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.effects.base import Effect
from idapt_pl.files import write_atomically, write_bytes, write_json, write_yaml
from idapt_pl.report.diagnosis_figures import diagnosis_figures
from idapt_pl.report.diagnosis_page import diagnosis_page
from idapt_pl.report.diagnosis_wording import verdict_in_words
from idapt_pl.report.fault_section import fault_section


def write_diagnosis(
    diagnosis: Diagnosis,
    folder: Path,
    model_name: str,
    data_name: str,
    faults: FaultReport | None = None,
    fixed: bool = False,
) -> None:
    """Write everything a diagnosis leaves behind.

    Args:
        diagnosis: finished.
        folder: made if it is not there; also TensorBoard's log folder.
        model_name: of the nominal model, for the page's title.
        data_name: of the recordings.
        faults: of the recordings, where they were tested for.
        fixed: whether the diagnosis is of the mended recordings.

    Raises:
        RuntimeError: the repaired model does not load from ``folder``.
    """
    tested = {} if faults is None else {"deployment_faults": faults.to_dict(fixed)}
    write_json(folder / "report.json", diagnosis.report | tested)
    write_yaml(folder / "effects.yaml", [e.to_dict() for e in accepted_effects(diagnosis)])
    repaired = repair_model(diagnosis.sim.spec, diagnosis.effects, folder)
    drawn = diagnosis_figures(diagnosis)
    html = diagnosis_page(diagnosis, repaired, drawn, model_name, data_name, fault_section(faults, fixed))
    write_atomically(folder / "report.html", lambda path: path.write_text(html, encoding="utf-8"))
    log_diagnosis(folder, diagnosis, drawn)
    write_bytes(folder / "unrepaired.xml", repaired.nominal.encode())
    write_atomically(folder / "patched.xml", lambda path: write_loadable_model(path, repaired.patched))


def accepted_effects(diagnosis: Diagnosis) -> list[Effect]:
    """What the diagnosis adds to the effects declared before, as a domain or ``idapt diagnose --effects`` takes it."""
    return [e for e in diagnosis.effects if e not in diagnosis.declared]


def write_loadable_model(path: Path, xml: str) -> None:
    """Write a model and load it again."""
    path.write_text(xml, encoding="utf-8")
    try:
        mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise RuntimeError(
            f"{path.parent}: the repaired model does not load ({' '.join(str(error).split())}), so there is no "
            "patched.xml; the effects are in effects.yaml"
        ) from None


def log_diagnosis(folder: Path, diagnosis: Diagnosis, drawn: dict[str, Figure]) -> None:
    """Errors, estimates with their intervals, the verdict and the figures; events of an earlier run are removed."""
    result = diagnosis.result
    for old in folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(folder) as writer:
        errors = result.error.to_dict()
        for name in ("before", "after", "noise_floor", "ceiling", "removed_share"):
            writer.add_scalar(f"error/{name}", errors[name], 0)
        for effect in result.effects:
            for name, p in effect.parameters.items():
                if isinstance(p.estimate, str):
                    continue
                tag = f"effects/{effect.effect}/{effect.target}/{name}"
                for suffix, value in zip(("", "_low", "_high"), (p.estimate, *(p.ci95 or ())), strict=False):
                    writer.add_scalar(tag + suffix, value, 0)
        writer.add_text("verdict", " ".join(verdict_in_words(result, diagnosis.sim.model)), 0)
        for name, figure in drawn.items():
            writer.add_figure(name, figure, 0)
