"""A search that is looked at decides as it does otherwise; what each gate alone keeps out is told."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.gates import Watch, summarise, watched
from idapt_pl.diagnosis import acceptance, search
from idapt_pl.diagnosis.data import Windows
from idapt_pl.diagnosis.gates import Judged
from idapt_pl.diagnosis.search_state import SearchState
from idapt_pl.diagnosis.settings import SearchSettings
from idapt_pl.diagnosis.trial import Trial
from idapt_pl.diagnosis.whitening import WhitenedWindows
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping

N = 40
DAMPING = Candidate(JointDamping, "elbow", ("damping",), (0.0,), (0.1,))
ARMATURE = Candidate(JointArmature, "elbow", ("armature",), (0.0,), (0.1,))
HIDDEN = SimpleNamespace(answers=((frozenset({("joint_damping", "elbow")}),),))


@pytest.fixture
def state():
    windows = Windows(np.repeat(np.arange(8), 5), np.arange(N), np.array([1]))
    return SearchState((), (), SimpleNamespace(held_out=WhitenedWindows(windows, np.zeros((N, 1, 1)))))


def refined(candidate, gain, gain_error=0.01):
    return Trial(candidate, 0, 100.0, (np.array([0.05]),), 1.0, np.full(N, 4.0 - gain), gain, gain_error)


def decided(watch, state, *trials):
    judged = (Judged(SearchSettings(), True, t, np.full(N, 4.0), 4.0, further=False) for t in trials)
    told = [t if (r := watch.objection(j)) is None else t.rejected(r.reason, r.text) for t, j in
            zip(trials, judged, strict=True)]  # fmt: skip
    return watch.accept(state, told)[0]


def test_what_one_gate_alone_keeps_out_is_told(state):
    watch = Watch(HIDDEN)
    assert decided(watch, state, refined(ARMATURE, 3.0, gain_error=9.0)) is None
    (row,) = watch.rows
    assert (row["gate"], row["chosen"], row["instead_right"]) == ("sure_gain", "", 0)
    table = summarise([row | {"model": "m", "hidden": 1, "seed": 0}]).split("\n")
    assert "| `sure_gain` | 1 | 0 | 0 | 0 |" in table and "| `noticeable` | 0 | 0 | 0 | 0 |" in table


def test_what_two_gates_keep_out_neither_decides(state):
    watch = Watch(HIDDEN)
    assert decided(watch, state, refined(ARMATURE, 0.05, gain_error=9.0)) is None
    assert watch.rows == []


def test_a_better_one_that_is_kept_out_would_have_been_chosen_and_is_right(state):
    watch = Watch(HIDDEN)
    made = decided(watch, state, refined(ARMATURE, 2.0), refined(DAMPING, 3.0, gain_error=9.0))
    assert made.accepted[0].candidate is ARMATURE
    (row,) = watch.rows
    assert (row["chosen_right"], row["instead"], row["instead_right"]) == (0, DAMPING.label, 1)


def test_nothing_stays_patched():
    before = acceptance.objection, search.accept
    with pytest.raises(RuntimeError), watched(HIDDEN):
        assert search.accept is not before[1]
        raise RuntimeError
    assert (acceptance.objection, search.accept) == before
