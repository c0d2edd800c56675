"""The table that a run ends with calls policies by their method, and scores by what they are."""

from cli.table import measured_policies

SUMMARY = {"direct_transfer": 0.25, "visual_only": 0.85, "grounded": [0.95, None], "effects": [], "settled": None}


def test_shares_of_successes_are_not_rounded_away():
    rows = dict(measured_policies(SUMMARY | {"metric": "success", "method": "idapt", "oracle": 1.0}))
    assert rows["direct transfer"] == "25 %" and rows["IDAPT, grounding step 1"] == "95 %" and rows["oracle"] == "100 %"
    assert rows["IDAPT, grounding step 2"] == "not measured"


def test_another_methods_steps_have_its_name():
    rows = dict(measured_policies(SUMMARY | {"metric": "return", "method": "cc_image", "oracle": None}))
    assert "CC-Image, grounding step 2" in rows and not any("IDAPT" in name for name in rows)
    assert rows["oracle"] == "not run (--oracle true)"
