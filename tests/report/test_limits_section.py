"""How small a change would have been seen, in words and as a table."""

import json
import math
from dataclasses import replace

from idapt_pl.diagnosis.answer.detection_limits import DetectionLimit
from idapt_pl.report.limits_section import SHOWN_LIMITS, limit_sentence, limits_section

FRICTION = DetectionLimit("joint_frictionloss", "hinge", "frictionloss", 0.0, 0.0249, "N·m")
SLIDER = DetectionLimit("joint_frictionloss", "slider", "frictionloss", 0.0, 0.233, "N")
POLE = DetectionLimit("body_mass", "pole", "mass", 5.0, 0.11, "kg")
CART = DetectionLimit("body_mass", "cart", "mass", 10.0, 0.12, "kg")
UNSEEN = DetectionLimit("joint_armature", "slider", "armature", 0.0, math.inf, "kg")


def test_the_sentence_tells_where_each_effect_shows_worst_and_mixes_no_units():
    told = limit_sentence([FRICTION, SLIDER, CART, POLE, UNSEEN])
    assert "dry friction on joint hinge, 0.025 N·m;" in told and "dry friction on joint slider, 0.23 N;" in told
    assert "mass of body pole, 2.2 % (elsewhere less)" in told, "2.2 % of 5 kg, 1.2 % of 10"
    assert "armature" not in told


def test_nothing_is_said_where_nothing_would_be_seen_or_no_limits_are_known():
    assert limit_sentence([]) == limit_sentence([UNSEEN]) == limits_section([]) == ""


def test_the_table_has_a_row_for_each_and_folds_many_away():
    few = limits_section([FRICTION, POLE, UNSEEN])
    assert few.count("<tr>") == 4 and "<details>" not in few
    assert ">2.2<" in few and ">%<" in few and "none is seen" in few
    many = limits_section([replace(FRICTION, target=f"joint{k}") for k in range(SHOWN_LIMITS + 3)])
    assert "3 more" in many and f"joint{SHOWN_LIMITS + 2}" in many


def test_in_report_json_what_is_never_seen_is_null():
    entries = json.loads(json.dumps([UNSEEN.to_dict(), POLE.to_dict()]))
    assert entries[0]["change"] is None
    assert entries[1] == {
        "effect": "body_mass", "target": "pole", "parameter": "mass", "nominal": 5.0, "change": 0.11, "unit": "kg",
    }  # fmt: skip
