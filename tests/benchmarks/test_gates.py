"""A search that is looked at decides as it does otherwise; what each gate alone keeps out is told."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.gates import Watch, sufficient, summarise, watched
from idapt_pl.diagnosis import search
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds import acceptance
from idapt_pl.diagnosis.rounds.gates import Judged
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

N = 40
DAMPING = Candidate(JointDamping, "elbow", ("damping",), (0.0,), (0.1,))
ARMATURE = Candidate(JointArmature, "elbow", ("armature",), (0.0,), (0.1,))
NAMES = {ord("a"): "sure_gain", ord("b"): "share_of_error", ord("c"): "noticeable"}
HIDDEN = SimpleNamespace(answers=((frozenset({("joint_damping", "elbow")}),),))


@pytest.fixture
def state():
    windows = Windows(np.repeat(np.arange(8), 5), np.arange(N), np.array([1]))
    return SearchState((), (), SimpleNamespace(held_out=WhitenedWindows(windows, np.zeros((N, 1, 1)))))


def refined(candidate, gain, gain_error=0.01):
    return Trial(candidate, 0, 100.0, (np.array([0.05]),), 1.0, np.full(N, 4.0 - gain), gain, gain_error)


def decided(watch, state, *trials):
    judged = (Judged(t.candidate, t.x[-1], t.gain, t.gain_error, 4.0, False, SearchSettings()) for t in trials)
    told = [t if (r := watch.objection(j)) is None else t.rejected(r.reason, r.text) for t, j in
            zip(trials, judged, strict=True)]  # fmt: skip
    return watch.accept(state, told)[0]


CASE = {"model": "m", "hidden": 1, "seed": 0}


def test_a_search_decides_as_ever_and_who_stood_for_choice_is_told(state):
    watch = Watch(HIDDEN)
    made = decided(watch, state, refined(ARMATURE, 2.0), refined(DAMPING, 3.0, gain_error=9.0))
    assert made.accepted[0].candidate is ARMATURE
    first, second = watch.rows
    assert (first["right"], first["gates"], first["chosen"]) == (0, "", 1)
    assert (second["right"], second["gates"], second["chosen"]) == (1, "sure_gain", 0)
    assert second["before"] == 4.0 and second["after"] == 1.0


def test_what_gates_do_alone_and_together_is_counted(state):
    watch = Watch(HIDDEN)
    assert decided(watch, state, refined(ARMATURE, 0.05, gain_error=9.0), refined(DAMPING, 3.0, gain_error=9.0)) is None
    table = summarise([CASE | row for row in watch.rows]).split("\n")
    assert "| `sure_gain` | 1 | 0 | 1 | 1 |" in table and "| `share_of_error` | 1 | 0 | 0 | 0 |" in table
    assert table[-1] == "| `sure_gain` | 1 |", "the damping is right, and may pass"
    assert summarise([CASE | {"hidden": 0}]).startswith("1 cases, 1 of them controls."), "nothing was even judged"


def test_gates_are_taken_until_all_wrong_ones_stay_out():
    rows = [{"gates": gates, "right": 0} for gates in ("a b", "a", "b", "b c", "c")]
    named = sufficient([r | {"gates": r["gates"].translate(NAMES)} for r in rows])
    assert [name for name, _ in named] == ["share_of_error", "sure_gain", "noticeable"]
    assert sum(count for _, count in named) == 5


def test_gates_that_are_gone_are_told_of_rows_of_earlier_versions():
    rows = [CASE | {"gates": "once_asked", "right": 0, "chosen": 0, "decision": 1}]
    assert sufficient(rows) == [("once_asked", 1)]
    assert "| `once_asked` | 1 | 1 | 0 | 0 |" in summarise(rows).split("\n")


def test_nothing_stays_patched():
    before = acceptance.objection, search.accept
    with pytest.raises(RuntimeError), watched(HIDDEN):
        assert search.accept is not before[1]
        raise RuntimeError
    assert (acceptance.objection, search.accept) == before
