"""The files of a diagnosis: report.json, report.html, settings.md, patched.xml, effects.yaml and TensorBoard's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
from matplotlib.figure import Figure

from idapt_pl.deployment_faults import FaultReport
from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.effects.base import Effect
from idapt_pl.files import write_atomically, write_bytes, write_json, write_yaml
from idapt_pl.recording_sets import SetComparison
from idapt_pl.report.actuator_settings import drive_settings
from idapt_pl.report.changed_settings import changed_settings
from idapt_pl.report.diagnosis_figures import diagnosis_figures
from idapt_pl.report.diagnosis_page import diagnosis_page
from idapt_pl.report.diagnosis_wording import verdict_in_words
from idapt_pl.report.fault_section import fault_section
from idapt_pl.report.html import paragraph, section
from idapt_pl.report.sets_section import common_is_worse, comparison_section
from idapt_pl.report.settings_table import settings_markdown, settings_to_take
from idapt_pl.report.stretch_section import stretch_section
from idapt_pl.stretches import StretchReport


@dataclass(frozen=True, eq=False)
class RecordingNotes:
    """What is known of recordings beside the diagnosis itself.

    Attributes:
        faults: of each file, by its name, where they were tested for.
        fixed: whether the diagnosis is of the mended recordings.
        stretches: what was left out.
        comparison: of several files; None for one.
        model_notes: what the model's file said that is not in the model, a sentence each.
        held: where joints are that the recordings hold still, rad or m.
    """

    faults: Mapping[str, FaultReport] | None = None
    fixed: bool = False
    stretches: StretchReport | None = None
    comparison: SetComparison | None = None
    model_notes: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``, beside what the diagnosis says."""
        made: dict[str, Any] = {}
        told = {name: f.to_dict(self.fixed) for name, f in (self.faults or {}).items()}
        if len(told) == 1:
            made["deployment_faults"] = next(iter(told.values()))
        if self.model_notes:
            made["model_notes"] = list(self.model_notes)
        if self.held:
            made["held_joints"] = dict(self.held)
        if self.stretches is not None:
            made["left_out"] = self.stretches.to_dict()
        if self.comparison is not None:
            made |= self.comparison.to_dict()
            for entry in made["recordings"]:
                entry["deployment_faults"] = told.get(entry["file"])
        return made

    def warnings(self) -> list[str]:
        """What a reader with a minute must know, a sentence each."""
        made = [held_sentence(self.held)] if self.held else []
        if count := sum(len(f.faults) for f in (self.faults or {}).values()):
            done = "taken out" if self.fixed else "still in: effects may stand for them"
            made.append(f"Deployment faults: {count}, {done}.")
        if self.stretches is not None and self.stretches.stretches:
            made.append(f"{100 * self.stretches.share:.2g} % were left out.")
        if self.comparison is not None and len(self.comparison.comparable) > 1:
            changed, unlike = len(self.comparison.changed), len(self.comparison.unlike)
            made.append(f"Values that differ between the {len(self.comparison.comparable)} files: {changed}.")
            made += [f"Files unlike the others: {unlike}."] * bool(unlike)
            made += [told] if (told := common_is_worse(self.comparison)) else []
        return made

    def sections(self) -> list[str]:
        """Of the page, after the verdict."""
        files = self.faults or {}
        faults = [fault_section(f, self.fixed, name if len(files) > 1 else "") for name, f in files.items()]
        lost = [paragraph(note[:1].upper() + note[1:] + ".") for note in self.model_notes]
        told = section("What the model's file lost", *lost) if lost else ""
        return [told, *faults, stretch_section(self.stretches), comparison_section(self.comparison)]


def held_sentence(held: Iterable[str]) -> str:
    """That joints are held while recordings are compared."""
    return f"Held where the recordings have them, as they never move there: {', '.join(held)}."


def write_diagnosis(
    diagnosis: Diagnosis,
    folder: Path,
    model_name: str,
    data_name: str,
    notes: RecordingNotes | None = None,
) -> None:
    """Write everything a diagnosis leaves behind.

    Args:
        diagnosis: finished.
        folder: made if it is not there; also TensorBoard's log folder.
        model_name: of the nominal model, for the page's title.
        data_name: of the recordings.
        notes: what is known of the recordings.

    Raises:
        RuntimeError: the repaired model does not load from ``folder``.
    """
    notes = notes or RecordingNotes()
    write_json(folder / "report.json", diagnosis.report | notes.to_dict())
    write_yaml(folder / "effects.yaml", [e.to_dict() for e in accepted_effects(diagnosis)])
    repaired = repair_model(diagnosis.sim.spec, diagnosis.effects, folder)
    drawn = diagnosis_figures(diagnosis)
    changes, (drives, unsaid) = changed_settings(diagnosis, repaired, folder), drive_settings(diagnosis)
    html = diagnosis_page(
        diagnosis, repaired, drawn, model_name, data_name, notes.sections(), notes.warnings(),
        settings_to_take(changes, drives, unsaid),
    )  # fmt: skip
    outside = [(e.name, e.target) for e in repaired.unsaid]
    text = settings_markdown(changes, drives, unsaid, (model_name, data_name), outside)
    write_atomically(folder / "settings.md", lambda path: path.write_text(text, encoding="utf-8"))
    write_atomically(folder / "report.html", lambda path: path.write_text(html, encoding="utf-8"))
    log_diagnosis(folder, diagnosis, drawn)
    write_bytes(folder / "unrepaired.xml", repaired.nominal.encode())
    (folder / "patched.xml").unlink(missing_ok=True)  # an older one would stand beside effects that it has not
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
    # torch takes seconds to load, and a diagnosis needs it here alone
    from torch.utils.tensorboard import SummaryWriter

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
