"""Responses of candidates are kept while the model stays near, and no longer."""

import numpy as np
import pytest

from idapt_pl.diagnosis.candidates.responses import Responses
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.whitening import WhitenedWindows

N, J, CHANNELS = 5, 2, 3


def split(start: int = 0) -> WhitenedWindows:
    windows = Windows(np.zeros(N, int), start + np.arange(N), np.array([1, 2]))
    return WhitenedWindows(windows, np.tile(2.0 * np.eye(J * CHANNELS), (N, 1, 1)))


@pytest.fixture
def residual():
    return np.random.default_rng(0).normal(size=(N, J, CHANNELS))


def never():
    pytest.fail("it was simulated before, under a model much like this one")


def test_a_response_is_whitened_by_what_windows_are_whitened_with_now(residual):
    responses = Responses()
    z = responses.under(split(), residual).get("effect", lambda: 3 * residual)
    assert z == pytest.approx(6 * residual.reshape(N, -1))


def test_it_is_simulated_once_while_the_model_stays_near(residual):
    responses = Responses()
    first = responses.under(split(), residual).get("effect", lambda: residual)
    again = responses.under(split(), 0.6 * residual).get("effect", never)
    assert again == pytest.approx(first, rel=1e-6)


def test_a_model_that_moved_by_more_than_is_left_under_either_is_another_one(residual):
    responses, made = Responses(), []

    def simulate():
        made.append(1)
        return residual

    responses.under(split(), residual).get("effect", simulate)
    responses.under(split(), 0.4 * residual).get("effect", simulate)
    assert len(made) == 2, "much was explained in between"
    responses.under(split(), 0.45 * residual).get("effect", never)
    responses.under(split(), residual).get("effect", simulate)
    assert len(made) == 3, "and what was explained may be left out again"


def test_other_windows_are_other_responses(residual):
    responses, made = Responses(), []
    for start in (0, 7):
        responses.under(split(start), residual).get("effect", lambda: made.append(1) or residual)
    assert len(made) == 2


def test_where_memory_is_full_nothing_new_is_kept(residual, monkeypatch):
    monkeypatch.setattr("idapt_pl.diagnosis.candidates.responses.MOST_BYTES", 1.5 * residual.nbytes / 2)
    responses, made = Responses(), []
    for key in ("one", "two", "two"):
        responses.under(split(), residual).get(key, lambda: made.append(1) or residual)
    assert len(made) == 3
    responses.under(split(), residual).get("one", never)
