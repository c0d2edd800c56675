"""Effects that change, in words, as a plot, and as they are in report.json."""

import json

import numpy as np
import pytest

from idapt_pl.diagnosis.answer.changes import ChangeFinding, ChangeReport
from idapt_pl.report.change_section import change_figure, change_section, change_sentences

KINDS = {
    "drift_within": ("drifts in every episode, from 0.1 to 0.3 N·m·s/rad", None, None),
    "decay_within": ("settles in every episode, from 0.1 to 0.3 N·m·s/rad, with a time constant of 1.5 s", 1.5, None),
    "step_within": ("steps in every episode at 2 s, from 0.1 to 0.3", 2.0, None),
    "drift_over": ("drifts from episode to episode, from 0.1 to 0.3", None, None),
    "step_over": ("steps at 0.4 s of episode 3, from 0.1 to 0.3", 0.4, 3),
}
SERIES = tuple((float(i), 0.1 + 0.04 * i, 0.02) for i in range(6))


def change(kind, at=None, episode=None, p=0.004):
    return ChangeFinding("joint_damping", "elbow", "damping", "N·m·s/rad", kind, 0.1, 0.3, at, episode, p, 0.62, SERIES)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_change_is_told_and_drawn_from_its_first_value_to_its_last(kind):
    words, at, episode = KINDS[kind]
    f = change(kind, at, episode)
    (sentence,) = change_sentences(ChangeReport(3, [f]))
    assert words in sentence and "(p = 0.004)" in sentence and "62 % of what is left" in sentence
    axis = change_figure(f).axes[0]
    measured, drawn = axis.lines[0].get_xydata(), axis.lines[-1].get_xydata()
    np.testing.assert_allclose(measured, [s[:2] for s in SERIES])
    assert (drawn[0, 1], drawn[-1, 1]) == pytest.approx((0.1, 0.3))
    assert (drawn[0, 0], drawn[-1, 0]) == (0.0, 5.0), "over all that was measured"
    assert axis.get_xlabel() == ("time in the episode (s)" if "within" in kind else "episode")
    if kind.startswith("step"):
        assert drawn[1, 0] == (2.0 if kind == "step_within" else 3.0)


def test_the_page_has_a_plot_for_each_change_and_says_where_there_is_none():
    page = change_section(ChangeReport(5, [change("drift_over"), change("step_within", at=2.0)]))
    assert page.count("<svg") == 2 and page.count("does not stay the same") == 2
    assert "of the parameters tested (5) none changes" in change_section(ChangeReport(5, []))
    assert change_section(None) == change_section(ChangeReport(0, [])) == ""


def test_in_report_json():
    told = json.loads(json.dumps(ChangeReport(4, [change("step_over", 0.4, 3)]).to_dict()))
    (entry,) = told["found"]
    assert told["tested"] == 4
    assert {k: entry[k] for k in ("effect", "target", "parameter", "kind", "first", "last", "at", "episode", "p")} == {
        "effect": "joint_damping", "target": "elbow", "parameter": "damping", "kind": "step_over", "first": 0.1,
        "last": 0.3, "at": 0.4, "episode": 3, "p": 0.004,
    }  # fmt: skip
    assert entry["series"][2] == {"at": 2.0, "value": pytest.approx(0.18), "half_width": 0.02}
