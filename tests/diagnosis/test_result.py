"""A result as values, and as report.json: the same keys in the same order as in a stored report."""

import json
from pathlib import Path

import mujoco
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.answer.result import Alternative, EffectEstimate, ParameterEstimate, Verdict
from idapt_pl.diagnosis.search import diagnose

STORED = json.loads((Path(__file__).parent / "report.json").read_text(encoding="utf-8"))
"""The report of the diagnosis below: two effects, one of them with an equivalent, and numerics."""


@pytest.fixture(scope="module")
def result():
    """Damping and a delay are hidden, and the nominal model's time step is coarse."""
    nominal = mujoco.MjSpec.from_string(ARM.replace('timestep="0.004"', 'timestep="0.02"'))
    data = record(ARM.replace('damping="0.02"', 'damping="0.06"'), delay=4, noise=(1e-4, 1e-3))
    return diagnose(nominal, data, candidates=["joint_damping", "actuator_delay", "actuator_bias"]).result


def outline(value):
    """Keys in their order and types of values; lists and texts may differ in length."""
    if isinstance(value, dict):
        return [(key, outline(v)) for key, v in value.items()]
    return [outline(v) for v in value] if isinstance(value, list) else type(value).__name__


def test_report_json_has_the_keys_of_the_schema_in_their_order(result):
    written = json.loads(json.dumps(result.to_dict()))
    for part in STORED.keys() | written.keys():
        assert outline(written[part]) == outline(STORED[part]), part
    assert list(written) == list(STORED)


def test_report_json_has_the_values_of_the_stored_report(result):
    written = json.loads(json.dumps(result.to_dict()))
    for name in ("schema", "verdict", "declared", "signature"):
        assert written[name] == STORED[name]
    for name, value in STORED["error"].items():
        if isinstance(value, float):
            assert written["error"][name] == pytest.approx(value, rel=1e-3, abs=1e-4), name
    for ours, theirs in zip(written["effects"], STORED["effects"], strict=True):
        assert (ours["effect"], ours["target"]) == (theirs["effect"], theirs["target"])
        for name, p in theirs["parameters"].items():
            estimate = p["estimate"] if isinstance(p["estimate"], str) else pytest.approx(p["estimate"], rel=1e-3)
            assert ours["parameters"][name]["estimate"] == estimate
    rejected = [[(c["effect"], c["target"], c["round"]) for c in r["candidates"]] for r in (written, STORED)]
    assert rejected[0] == rejected[1]


def test_numbers_are_rounded_to_what_is_worth_reading(result):
    assert result.error.before == round(result.error.before, 4)
    for effect in result.effects:
        for p in effect.parameters.values():
            assert isinstance(p.estimate, str) or p.estimate == float(f"{p.estimate:.6g}")


@pytest.mark.parametrize("entry", STORED["effects"], ids=lambda e: e["effect"])
def test_effects_survive_the_way_through_json(entry):
    there = EffectEstimate.from_dict(entry)
    assert json.dumps(there.to_dict()) == json.dumps(entry)
    assert EffectEstimate.from_dict(there.to_dict()) == there


def test_what_an_entry_leaves_out_is_empty():
    few = {"effect": "numerics", "target": "world", "parameters": {}}
    assert EffectEstimate.from_dict(few) == EffectEstimate("numerics", "world", {})


def test_a_verdict_is_its_word():
    assert Verdict("effects_found") is Verdict.EFFECTS_FOUND == "effects_found"
    with pytest.raises(ValueError, match="perhaps"):
        Verdict("perhaps")


def test_intervals_and_alternatives_are_values():
    p = ParameterEstimate.from_dict({"nominal": 0.0, "estimate": 1.0, "ci95": [0.9, 1.1], "unit": "kg"})
    assert p.ci95 == (0.9, 1.1) and p.to_dict()["ci95"] == [0.9, 1.1]
    other = {"effect": "sensor_delay", "target": "*", "parameters": {"delay": 0.02}, "why": "the same"}
    assert Alternative.from_dict(other).to_dict() == other
