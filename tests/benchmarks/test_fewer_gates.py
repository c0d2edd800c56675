"""A search with fewer gates is told from one with all where these would have judged in another way."""

import numpy as np
import pytest

from benchmarks.fewer_gates import NEVER_ALONE, Fewer, judged_by, run, summarise
from idapt_pl.diagnosis.candidates.trial import RejectionReason
from idapt_pl.diagnosis.rounds import acceptance
from idapt_pl.diagnosis.rounds.gates import GATES, Judged
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping

DAMPING = Candidate(JointDamping, "elbow", ("damping",), (0.0,), (0.1,))


def judged(gain, gain_error=0.01):
    return Judged(DAMPING, np.array([0.05]), gain, gain_error, 4.0, False, SearchSettings())


def test_gates_that_are_left_out_are_those_of_the_diagnosis():
    assert set(NEVER_ALONE) < {gate.__name__ for gate in GATES}


@pytest.mark.parametrize(
    ("gain", "gain_error", "told", "parted"),
    [(3.0, 0.01, None, False), (0.05, 0.01, None, True), (3.0, 9.0, RejectionReason.UNSURE_GAIN, False)],
    ids=["passes all", "too small, which no gate says any more", "unsure for both"],
)
def test_where_all_gates_would_have_judged_otherwise_searches_part(gain, gain_error, told, parted):
    fewer = Fewer(NEVER_ALONE)
    made = fewer.objection(judged(gain, gain_error))
    assert (made and made.reason) == told and fewer.parted is parted


def test_afterwards_all_gates_are_back():
    before = acceptance.objection
    with pytest.raises(RuntimeError, match="in between"), judged_by(NEVER_ALONE):
        assert acceptance.objection(judged(0.05)) is None
        raise RuntimeError("in between")
    assert acceptance.objection is before and acceptance.objection(judged(0.05)) is not None


def test_a_case_is_recorded_searched_and_told():
    row = run("inverted_pendulum", 1, 1, NEVER_ALONE)
    assert row["exact"] == row["exact_all"] == 1 and row["found"] and row["loss"] < 2
    table = summarise([row | {"without": "noticeable", "recorded": "well"}])
    assert table.splitlines()[-1] == f"| `noticeable` | well | 1 | {row['parted']} | 1 | 1 | 0 | 0 |"
