"""Explanations come from a report; a model or a report that does not fit is refused in a sentence."""

import json

import mujoco
import numpy as np
import pytest
from arms import DAMPING, FRICTION, RAIL, SERVO, report_folder

from idapt_pl.diagnosis.answer.explanation import Standing
from idapt_pl.diagnosis.answer.repaired import repair_model
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.joints import JointDamping
from idapt_pl.excitation.limits import ImpossibleMotion
from idapt_pl.excitation.rivals import alike, read_left_open


def read(folder, model="nominal.xml"):
    return read_left_open(folder / model, folder / "diagnosis")


def test_explanations_have_their_fitted_values(tmp_path):
    left_open = read(report_folder(tmp_path, DAMPING, FRICTION))
    damping, friction = left_open.rivals
    assert damping.effects == (JointDamping("shoulder", 0.6),) and damping.x[0] == pytest.approx([0.6])
    assert damping.candidates[0].nominal == (0.2,) and damping.candidates[0].scale == (0.2,)
    assert (damping.standing, friction.standing) == (Standing.FOUND, Standing.EQUIVALENT)
    assert damping.name == "viscous friction (damping) on joint shoulder"
    assert left_open.intervals["joint_damping", "shoulder", "damping"] == pytest.approx((0.54, 0.66))


def test_the_repaired_model_is_traced_back_to_the_one_diagnosed(tmp_path):
    report_folder(tmp_path, DAMPING, FRICTION)
    spec = mujoco.MjSpec.from_string(SERVO)
    JointDamping("shoulder", 0.6).apply(spec)
    spec.compile()
    (tmp_path / "diagnosis" / "patched.xml").write_text(spec.to_xml())
    for model in ("nominal.xml", "diagnosis/patched.xml"):
        assert read(tmp_path, model).spec.compile().dof_damping[0] == pytest.approx(0.2)


@pytest.mark.parametrize("xml", [SERVO, RAIL])
def test_every_effect_in_a_repaired_model_is_seen(tmp_path, xml):
    """A repaired model that is taken for the nominal one would have what was found twice."""
    nominal, one = mujoco.MjSpec.from_string(xml), np.ones(1)
    sizes = TypicalSizes(0.02, 0.1 * one, one, 0.5 * one, 6 * one, 0.5 * one, 2 * one, 0.2)
    for candidate in all_candidates(nominal, sizes):
        for start in candidate.starts or (np.array(candidate.nominal) + candidate.scale,):
            repaired = repair_model(nominal, (candidate.effect(np.array(start)),), tmp_path)
            models = map(mujoco.MjModel.from_xml_string, (repaired.nominal, repaired.patched))
            assert alike(*models) == (repaired.nominal == repaired.patched), candidate.label


def test_a_report_of_before_this_version_is_read_with_the_nominal_model_alone(tmp_path):
    report_folder(tmp_path, DAMPING, FRICTION)
    (tmp_path / "diagnosis" / "unrepaired.xml").unlink()
    assert len(read(tmp_path).rivals) == 2


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: (f / "nominal.xml").write_text(SERVO.replace('mass="0.4"', 'mass="0.3"')), "neither the model"),
        (lambda f: change(f, explanations=[{"effects": 3}]), "does not say"),
        (lambda f: (f / "diagnosis" / "report.json").unlink(), "cannot be used"),
        (lambda f: (f / "diagnosis" / "report.json").write_text("{"), "cannot be used"),
        (lambda f: change(f, schema="other/1"), "expected a report of idapt diagnose"),
        (lambda f: change(f, explanations=[]), "found no effect"),
        (lambda f: change(f, measurement=None), "run idapt diagnose again"),
        (lambda f: (f / "nominal.xml").unlink(), "no such file"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(tmp_path, spoil, said):
    report_folder(tmp_path, DAMPING, FRICTION)
    spoil(tmp_path)
    with pytest.raises(ValueError, match=said):
        read(tmp_path)


def change(folder, **entries):
    path = folder / "diagnosis" / "report.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


def test_another_model_is_refused_without_its_copy_too(tmp_path):
    report_folder(tmp_path, DAMPING, FRICTION)
    (tmp_path / "diagnosis" / "unrepaired.xml").unlink()
    (tmp_path / "nominal.xml").write_text(SERVO.replace('"shoulder"', '"knee"'))
    with pytest.raises(ImpossibleMotion, match="does not fit"):
        read(tmp_path)
    with pytest.raises(ImpossibleMotion, match="no such folder"):
        read_left_open(tmp_path / "nominal.xml", tmp_path / "nowhere")
