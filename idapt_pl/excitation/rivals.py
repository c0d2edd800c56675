"""The explanations that a diagnosis left, as models to simulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from idapt_pl.diagnosis.answer.explanation import Explanation, Measurement, Standing
from idapt_pl.diagnosis.answer.result import DiagnosisResult
from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.candidates.held_joints import hold_joints
from idapt_pl.effects import effect_from_dict
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.wording import phrase_at
from idapt_pl.excitation.limits import ImpossibleMotion
from idapt_pl.files import DamagedFile, read_json
from idapt_pl.prediction.model import read_model
from idapt_pl.prediction.simulator import Effects
from idapt_pl.robot_files.read import is_urdf

REPEAT = "run idapt diagnose again, with this version"
"""What to do about a report that lacks something."""

COMPARED = (
    "body_mass", "body_inertia", "body_ipos", "dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature",
    "jnt_stiffness", "jnt_range", "qpos_spring", "actuator_gainprm", "actuator_biasprm", "actuator_dyntype",
    "actuator_dynprm", "actuator_delay", "actuator_gear", "actuator_ctrllimited", "actuator_ctrlrange",
    "actuator_forcelimited", "actuator_forcerange", "geom_friction", "geom_solref", "pair_friction", "pair_solref",
)  # fmt: skip
"""Arrays by which a model is known again: all that effects write to."""

COMPARED_OPTIONS = ("timestep", "integrator", "gravity", "density", "viscosity")
"""Options by which it is."""


@dataclass(frozen=True)
class Rival:
    """One explanation.

    Attributes:
        name: what is special about it, in words.
        standing: in the report.
        fixed: effects whose values are not fitted: declared ones and numerics.
        candidates: effects that are, with what can be fitted of them.
        x: their values, one array for each.
    """

    name: str
    standing: Standing
    fixed: Effects
    candidates: tuple[Candidate, ...]
    x: tuple[np.ndarray, ...]

    @property
    def effects(self) -> Effects:
        """All effects of the model."""
        return (*self.fixed, *effects_of(self.candidates, self.x))


@dataclass(frozen=True)
class LeftOpen:
    """What a diagnosis left open.

    Attributes:
        spec: the model before repair.
        rivals: explanations, what was found first.
        measurement: how the recordings were measured.
        intervals: 95 % intervals of the parameters found, by effect, target and parameter.
        held: where joints are that the recordings hold still, rad or m; the model holds them there.
    """

    spec: mujoco.MjSpec
    rivals: tuple[Rival, ...]
    measurement: Measurement
    intervals: Mapping[tuple[str, str, str], tuple[float, float]]
    held: Mapping[str, float] = field(default_factory=dict)


def read_left_open(model: Path, report: Path) -> LeftOpen:
    """Read the report of a diagnosis and the model that it is about.

    Args:
        model: the nominal model, or the repaired one (``patched.xml``). Of a URDF the report's own copy is taken, which
            has the actuators that it was diagnosed with.
        report: folder of the diagnosis.

    Raises:
        ImpossibleMotion: the report has no explanations, or the model is not that of the report.
    """
    if not report.is_dir():
        raise ImpossibleMotion(f"{report}: no such folder; expected the output of idapt diagnose --out")
    entry, kept = read_report(report / "report.json"), report / "unrepaired.xml"
    if is_urdf(model) and kept.is_file():
        model = kept
    spec = nominal_of(read_model(model), model, report)
    try:
        declared = tuple(effect_from_dict(e) for e in entry["declared"])
        rivals = tuple(rival_of(declared, Explanation.from_dict(e)) for e in entry["explanations"])
        measurement, intervals = Measurement.from_dict(entry["measurement"]), intervals_of(entry["effects"])
        held = {name: float(position) for name, position in entry.get("held_joints", {}).items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise ImpossibleMotion(
            f"{report / 'report.json'}: it does not say which explanations are left, or where joints were; {REPEAT}"
        ) from None
    if not rivals:
        raise ImpossibleMotion(
            f"{report}: the diagnosis found no effect ({entry['verdict']}), so there are no explanations to tell apart"
        )
    for rival in rivals:
        check_fit(spec, rival, model, report)
    compiled = spec.copy().compile()
    wanted, names = compiled.nv * (1 + measurement.velocities), {compiled.joint(j).name for j in range(compiled.njnt)}
    if missing := held.keys() - names:
        raise ImpossibleMotion(f"{model}: it has no joint {min(missing)!r}; give the model that was diagnosed")
    if len(measurement.sensor_noise) != wanted:
        raise ImpossibleMotion(
            f"{model}: it has {compiled.nv} degrees of freedom, but {report / 'report.json'} is about a model with "
            f"{len(measurement.initial_state_noise) // 2}; give the model that was diagnosed"
        )
    hold_joints(spec, held)
    return LeftOpen(spec, rivals, measurement, intervals, held)


def read_report(path: Path) -> dict[str, Any]:
    """The content of a ``report.json`` that says which explanations are left.

    Raises:
        ImpossibleMotion: it is missing, damaged, or of an older version.
    """
    try:
        entry = read_json(path, ("verdict", "effects", "declared"), f"{REPEAT[0].upper()}{REPEAT[1:]}.")
    except DamagedFile as error:
        raise ImpossibleMotion(str(error)) from None
    if entry.get("schema") != DiagnosisResult.SCHEMA:
        raise ImpossibleMotion(f"{path}: expected a report of idapt diagnose ({DiagnosisResult.SCHEMA})")
    if "explanations" not in entry or not entry.get("measurement"):
        raise ImpossibleMotion(f"{path}: it does not say which explanations are left; {REPEAT}")
    return entry


def nominal_of(given: mujoco.MjSpec, path: Path, report: Path) -> mujoco.MjSpec:
    """The model before repair, whether the repaired one or that one is given.

    Raises:
        ImpossibleMotion: it is neither.
    """
    kept = report / "unrepaired.xml"
    if not kept.is_file():
        return given
    nominal, model = read_model(kept), given.copy().compile()
    if alike(model, nominal.copy().compile()):
        return given
    patched = report / "patched.xml"
    if patched.is_file() and alike(model, read_model(patched).compile()):
        return nominal
    raise ImpossibleMotion(
        f"{path}: it is neither the model that was diagnosed ({kept}) nor the repaired one (patched.xml beside it); "
        "give one of these"
    )


def alike(a: mujoco.MjModel, b: mujoco.MjModel) -> bool:
    """Whether two models are the same, as far as six digits tell."""
    if (a.nq, a.nv, a.nu, a.nbody, a.ngeom, a.npair) != (b.nq, b.nv, b.nu, b.nbody, b.ngeom, b.npair):
        return False
    names = [[m.joint(j).name for j in range(m.njnt)] + [m.actuator(i).name for i in range(m.nu)] for m in (a, b)]
    values = [[*(getattr(m, n) for n in COMPARED), *(getattr(m.opt, n) for n in COMPARED_OPTIONS)] for m in (a, b)]
    return names[0] == names[1] and all(np.allclose(x, y, rtol=1e-4, atol=1e-7) for x, y in zip(*values, strict=True))


def rival_of(declared: Effects, e: Explanation) -> Rival:
    """An explanation as a model; its values come from the report."""
    fixed, candidates, x = list(declared), [], []
    for part in e.effects:
        if not part.free:
            fixed.append(part.effect)
            continue
        values = part.effect.to_dict()["parameters"]
        rest = tuple((k, tuple(v) if isinstance(v, list) else v) for k, v in values.items() if k not in part.free)
        names = tuple(part.free)
        nominal, scale = zip(*part.free.values(), strict=True)
        candidates.append(Candidate(type(part.effect), part.effect.target, names, nominal, scale, fixed=rest))
        x.append(np.array([values[n] for n in names], float))
    return Rival(rival_name(e), e.standing, tuple(fixed), tuple(candidates), tuple(x))


def rival_name(e: Explanation) -> str:
    """What an explanation is called: by the effect that it has instead, or by those found."""
    parts = [(p.effect.name, p.effect.target) for p in e.effects if p.free]
    special = [part for part in parts if f"{part[0]}({part[1]})" == e.instead]
    return " and ".join(phrase_at(*part) for part in special or parts)


def check_fit(spec: mujoco.MjSpec, rival: Rival, model: Path, report: Path) -> None:
    """Try the effects of an explanation on the model.

    Raises:
        ImpossibleMotion: they do not fit.
    """
    twin = spec.copy()
    try:
        for effect in rival.effects:
            effect.apply(twin)
        twin.compile()
    except ValueError as error:
        said = " ".join(str(error).split())
        raise ImpossibleMotion(f"{model}: it does not fit {report / 'report.json'}: {said}") from None


def intervals_of(effects: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str, str], tuple[float, float]]:
    """The 95 % intervals in a report."""
    return {
        (e["effect"], e["target"], name): (float(p["ci95"][0]), float(p["ci95"][1]))
        for e in effects
        for name, p in e["parameters"].items()
        if p["ci95"]
    }
