"""How probable explanations are: laws of the weights."""

import numpy as np
import pytest

from idapt_pl.diagnosis.answer.probabilities import HALF_UNEXPLAINED, NEVER_SURE, PER_PARAMETER, RARE, probabilities

ROWS = 20


@pytest.fixture
def noise():
    """Losses of the right explanation in 100 windows."""
    return np.random.default_rng(0).chisquare(ROWS, 100) / ROWS


def test_alone_and_down_to_the_noise_an_explanation_is_nearly_sure(noise):
    (p,) = probabilities([noise - max(noise.mean() - 1, 0)], ROWS, [1], [0])
    assert p == pytest.approx(1 - NEVER_SURE)


def test_equal_ones_share_by_how_usual_and_how_simple_they_are(noise):
    p = probabilities([noise] * 3, ROWS, [1, 2, 1], [0, 0, 1])
    assert p / p[0] == pytest.approx(np.exp([0, -PER_PARAMETER, -RARE]))
    assert p.sum() <= 1 - NEVER_SURE + 1e-9


def test_a_worse_one_is_less_probable_the_surer_it_is_worse(noise):
    everywhere = noise + 0.05
    in_one_window = noise.copy()
    in_one_window[0] += 0.05 * len(noise)
    chance = [probabilities([noise, other], ROWS, [1, 1], [0, 0])[1] for other in (everywhere, in_one_window)]
    assert chance[0] < 0.01 < chance[1] < 0.5


def test_where_much_is_left_something_else_is_missing(noise):
    half = noise / noise.mean() + HALF_UNEXPLAINED
    assert probabilities([half], ROWS, [1], [0])[0] == pytest.approx(0.5)
    assert probabilities([noise + 20], ROWS, [1], [0])[0] < 0.05


def test_the_order_does_not_matter(noise):
    losses = [noise, noise + 0.01, noise + 0.02]
    p = probabilities(losses, ROWS, [1, 1, 2], [0, 0, 0])
    back = probabilities(losses[::-1], ROWS, [2, 1, 1], [0, 0, 0])
    assert back[::-1] == pytest.approx(p)
