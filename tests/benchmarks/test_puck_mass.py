"""A push is one, and masses are told apart where their ends are, and not where readings hide it."""

from contextlib import closing

import numpy as np
import pytest

from benchmarks.puck_mass import GOAL, MASSES, PUCK, SOURCE, TRUE, log_likelihoods, measure, play, record, world


def ends_of(shift, spread, pushes=60):
    """Forecasts of masses whose ends are ``shift`` apart, and readings of the true one."""
    rng = np.random.default_rng(0)
    noise = spread * rng.standard_normal((len(MASSES), pushes, 8, 2))
    ends = noise + shift * np.arange(len(MASSES))[:, None, None, None]
    return ends, TRUE * shift + spread * rng.standard_normal((pushes, 2))


@pytest.mark.parametrize(("shift", "told"), [(0.002, True), (0.00002, False)])
def test_a_shift_is_told_where_it_is_as_large_as_what_hides_it(shift, told):
    ends, read = ends_of(shift, 0.001)
    found = log_likelihoods(ends, read, 0.001)
    assert bool(found[TRUE] - found[SOURCE] > 3) is told
    if told:
        assert found.argmax() == TRUE


def test_a_push_brings_the_puck_nearer_and_its_commands_do_so_again():
    with closing(world(MASSES[SOURCE])) as env:
        state = env.reset(seed=4)[0]["state"][0].copy()
        commands, end = record(env, 4)
        again = play(env, commands, 4, np.zeros(2))
        aside = play(env, commands, 4, np.array([0.02, 0.0]))
    before, after = (np.linalg.norm(state[GOAL] - p) for p in (state[PUCK], end))
    assert after < before - 0.1 and again == pytest.approx(end, abs=1e-6)
    assert np.linalg.norm(aside - end) > 1e-3


def test_a_row_says_what_pushes_tell():
    with closing(world(MASSES[TRUE])) as env:
        row = measure([record(env, k) for k in range(2)], 0.001, 0)
    assert row["chosen_kg"] in MASSES and row["true_kg"] == 0.05 and row["pushes"] == 2
    assert np.isfinite(row["nats"]) and 0.01 < row["spread_mm"] < 50 and row["shift_mm"] > 0
