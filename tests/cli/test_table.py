"""The table that a run ends with calls policies by their method, and scores by what they are."""

import logging
from pathlib import Path

import pytest

from cli.table import measured_policies, print_summary
from idapt_pl.run_folder.kept_warnings import keeping_warnings

SUMMARY = {"direct_transfer": 0.25, "visual_only": 0.85, "grounded": [0.95, None], "effects": [], "settled": None}


def test_shares_of_successes_are_not_rounded_away():
    rows = dict(measured_policies(SUMMARY | {"metric": "success", "method": "idapt", "oracle": 1.0}))
    assert rows["direct transfer"] == "25 %" and rows["IDAPT, grounding step 1"] == "95 %" and rows["oracle"] == "100 %"
    assert rows["IDAPT, grounding step 2"] == "not measured"


def test_another_methods_steps_have_its_name():
    rows = dict(measured_policies(SUMMARY | {"metric": "return", "method": "cc_image", "oracle": None}))
    assert "CC-Image, grounding step 2" in rows and not any("IDAPT" in name for name in rows)
    assert "oracle" not in rows, "what was not run has no row"


@pytest.mark.parametrize("by", [1.0, 200.0])
def test_a_shortened_run_ends_with_what_it_is_worth(by, capsys):
    told = {"metric": "return", "method": "idapt", "oracle": None, "task": "cart", "target": "hard", "seed": 0}
    told |= {"episodes": 2, "target_interactions": 9, "wall_s": 60.0, "rolled_back": [], "shortened_by": by}
    print_summary(SUMMARY | told, Path("my run"), Path("my run/report.html"))
    out = capsys.readouterr().out
    said = "lengths divided by 200: this shows that it runs, not what it can reach" in out
    assert "tensorboard --logdir 'my run'" in out, "a command that can be copied"
    assert said == (by != 1)


def test_what_a_run_warned_of_stands_at_its_end_as_it_was_said(tmp_path, capsys):
    told = {"metric": "return", "method": "idapt", "oracle": None, "task": "cart", "target": "hard", "seed": 0}
    told |= {"episodes": 2, "target_interactions": 9, "wall_s": 60.0, "rolled_back": [], "shortened_by": 1.0}
    with keeping_warnings(tmp_path):
        logging.getLogger("idapt_pl.stages").warning("view {share: 0.7} [of the frames] shows them")
    print_summary(SUMMARY | told, tmp_path, tmp_path / "report.html")
    assert "warned: view {share: 0.7} [of the frames] shows them" in capsys.readouterr().out
