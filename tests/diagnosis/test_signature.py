"""What a residual goes along with."""

import numpy as np
import pytest

from idapt_pl.diagnosis.answer.signature import correlation


def test_what_a_residual_goes_along_with_is_a_share_of_it():
    rng = np.random.default_rng(0)
    x, constant = rng.normal(size=500), np.ones(500)
    assert correlation(x, 3 * x + 7) == pytest.approx(1) and correlation(-x, x) == pytest.approx(-1)
    assert correlation(constant, constant * -4e-9) == pytest.approx(-1), "a residual that is the same everywhere"
    assert abs(correlation(constant, x)) < 0.1 and abs(correlation(x, rng.normal(size=500))) < 0.1
    assert correlation(x, constant) == 0 and correlation(0 * x, x) == 0
