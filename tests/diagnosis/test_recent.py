"""Results that are kept: the same again, and no more bytes than allowed."""

import numpy as np
import pytest

from idapt_pl.prediction.recent import RecentArrays


def test_what_was_made_is_not_made_again():
    kept, made = RecentArrays[np.ndarray](1000), []

    def make():
        made.append(1)
        return np.arange(3.0)

    assert kept.get("a", make) is kept.get("a", make)
    assert len(made) == 1 and kept.found == 1


def test_what_was_not_asked_for_the_longest_goes_first():
    kept = RecentArrays[np.ndarray](2 * 80)
    for key in ("a", "b", "a", "c"):
        kept.get(key, lambda: np.zeros(10))
    assert kept.bytes == 160
    kept.get("a", lambda: pytest.fail("a was asked for after b"))
    again = []
    kept.get("b", lambda: again.append(1) or np.zeros(10))
    assert again


def test_one_result_larger_than_all_that_is_allowed_is_kept_alone():
    kept = RecentArrays[np.ndarray](8)
    kept.get("a", lambda: np.zeros(10))
    kept.get("b", lambda: np.zeros(20))
    assert kept.bytes == 160
    kept.get("b", lambda: pytest.fail("the last result is kept"))


def test_pairs_are_kept_too_and_nobody_can_write_to_what_others_get():
    kept = RecentArrays[tuple[np.ndarray, np.ndarray]](1000)
    q, v = kept.get("a", lambda: (np.zeros(2), np.ones(3)))
    assert kept.bytes == 40
    for array in (q, v):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
