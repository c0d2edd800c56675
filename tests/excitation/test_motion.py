"""A series starts and ends at rest, never leaves its range, and gets smaller when its coefficients do."""

import numpy as np
import pytest

from idapt_pl.excitation.motion import envelope, fourier_motion, spread

RANGE = np.array([[-1.0, 0.5], [-2.0, 2.0]])


@pytest.fixture(scope="module")
def motion():
    return fourier_motion(np.tile([0.2, 0.0], (150, 1)), RANGE, 0.02, 2.5)


def test_commands_start_and_end_at_the_pose_and_stay_in_range(motion):
    u = motion.commands(3 * motion.random(np.random.default_rng(0), 50))
    assert u.shape == (50, 150, 2)
    assert np.allclose(u[:, [0, -1]], [0.2, 0.0])
    assert (u >= RANGE[:, 0] - 1e-12).all() and (u <= RANGE[:, 1] + 1e-12).all()
    assert np.abs(u - [0.2, 0.0]).max((0, 1)) == pytest.approx([1.2, 2.0], rel=1e-6)  # the range is used


def test_no_coefficients_are_no_motion(motion):
    assert np.allclose(motion.commands(np.zeros((1, motion.size))), [0.2, 0.0])


def test_half_the_coefficients_are_half_the_motion_once_nothing_is_cut(motion):
    x = 4 * motion.random(np.random.default_rng(1), 1)[0]
    y = motion.reachable(x)
    assert np.allclose(motion.commands(y[None]), motion.commands(x[None]))
    whole, half = motion.commands(np.stack([y, y / 2])) - motion.around
    assert np.allclose(half, whole / 2)


def test_frequencies_reach_from_once_a_motion_to_the_fastest(motion):
    assert motion.harmonics[:, 0].tolist() == [1, 1] and motion.harmonics.max() <= 2.5 * 150 * 0.02
    assert all(len(set(row)) == len(row) for row in motion.harmonics.tolist())
    spectrum = np.abs(np.fft.rfft(motion.commands(motion.random(np.random.default_rng(2), 1))[0, :, 1]))
    assert spectrum[20:].max() < 0.02 * spectrum.max()  # 6.7 Hz and more


def test_recorded_commands_are_added_to(motion):
    base = np.stack([np.linspace(0, 0.3, 100), np.linspace(1, -1, 100)], 1)
    added = fourier_motion(base, RANGE, 0.02, 2.0)
    assert np.allclose(added.commands(np.zeros((1, added.size)))[0], base)
    u = added.commands(5 * added.random(np.random.default_rng(0), 20))
    assert np.allclose(u[:, 0], base[0]) and (u <= RANGE[:, 1] + 1e-12).all()


def test_a_base_at_its_limit_leaves_the_rest_of_the_motion():
    """A policy's commands often are there; the series is cut at these steps alone."""
    base = np.stack([np.where(np.arange(150) % 50 < 10, 0.5, -0.2), np.zeros(150)], 1)
    added = fourier_motion(base, RANGE, 0.02, 2.0)
    u = added.commands(added.random(np.random.default_rng(0), 20))
    assert np.median(np.abs(u - base)[:, :, 0].max(1)) > 0.1 and (u <= RANGE[:, 1] + 1e-12).all()


def test_a_command_that_may_not_change_leaves_the_others_theirs():
    held = fourier_motion(np.tile([0.2, 0.0], (150, 1)), np.array([[-1.0, 0.5], [0.0, 0.0]]), 0.02, 2.0)
    u = held.commands(held.random(np.random.default_rng(0), 20))
    assert np.isfinite(u).all() and np.ptp(u[:, :, 1]) == 0 and np.median(np.ptp(u[:, :, 0], axis=1)) > 0.1


def test_an_envelope_is_smooth_and_symmetric():
    w = envelope(100, 0.02)
    assert w[0] == w[-1] == 0 and w[50] == 1 and np.allclose(w, w[::-1])
    assert np.abs(np.diff(w)).max() < 0.12


def test_harmonics_are_spread_where_they_meet():
    assert spread(np.array([1, 1, 2, 9]), 9).tolist() == [1, 2, 3, 9]
