"""Robust least squares: against SciPy, inside bounds, and the laws of its parts."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from idapt_pl.estimation.least_squares import (
    HUBER,
    ParameterBox,
    broyden,
    gauss_newton,
    huber,
    huber_weights,
    jacobian,
    kept_in_line,
    normal_equations,
    project_out,
    robust_loss,
    typical_loss,
    usual_windows,
)

TIME = np.linspace(0, 3, 60)
TRUTH = np.array([2.0, 0.7, -0.5])


def decay(x):
    """An exponential decay to an offset."""
    return x[0] * np.exp(-x[1] * TIME) + x[2]


@pytest.fixture
def residual():
    """Residuals (12, 5) in units of the noise; some measurements are far off."""
    rng = np.random.default_rng(0)
    seen = decay(TRUTH) + 0.02 * rng.normal(size=60)
    seen[::9] += rng.normal(size=7)
    return lambda x: ((seen - decay(x)) / 0.02).reshape(12, 5)


FREE = ParameterBox(np.ones(3), np.full(3, -10.0), np.full(3, 10.0))
START = np.array([1.0, 0.3, 0.0])


def test_the_minimum_is_scipys(residual):
    fit = gauss_newton(residual, START, FREE, iterations=40)
    theirs = least_squares(lambda x: residual(x).ravel(), START, loss="huber", f_scale=HUBER, xtol=1e-14, ftol=1e-14)
    assert fit.x == pytest.approx(theirs.x, rel=1e-3)
    assert fit.loss == pytest.approx(2 * theirs.cost / 60, rel=1e-4), "the same loss, up to a factor of two"
    assert fit.x == pytest.approx(TRUTH, abs=0.05), "outliers do not decide"


def test_bounds_are_kept_and_the_rest_is_fitted_at_them(residual):
    high = np.array([10.0, 0.5, 10.0])
    fit = gauss_newton(residual, START, ParameterBox(np.ones(3), FREE.low, high), iterations=40)
    theirs = least_squares(
        lambda x: residual(x).ravel(), START, loss="huber", f_scale=HUBER, bounds=(FREE.low, high), xtol=1e-14
    )
    assert fit.x[1] == 0.5
    assert fit.x == pytest.approx(theirs.x, rel=2e-3)


def test_a_start_outside_the_bounds_is_moved_inside(residual):
    fit = gauss_newton(residual, np.array([1.0, 99.0, 0.0]), FREE, iterations=1)
    assert (fit.x <= FREE.high).all()


def test_units_do_not_matter(residual):
    units = np.array([1e-3, 1.0, 1e3])
    scaled = ParameterBox(1 / units, FREE.low / units, FREE.high / units)
    fit = gauss_newton(lambda x: residual(x * units), START / units, scaled, iterations=40)
    assert fit.x * units == pytest.approx(gauss_newton(residual, START, FREE, iterations=40).x, rel=1e-6)


def test_a_fit_says_where_it_ended(residual):
    fit = gauss_newton(residual, START, FREE)
    np.testing.assert_array_equal(fit.z, residual(fit.x))
    assert fit.loss == robust_loss(fit.z).mean() and fit.J.shape == (60, 3)


def test_a_linear_problem_takes_one_step_and_little_damping():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(40, 2)), rng.normal(size=40)
    fit = gauss_newton(
        lambda x: (A @ x - b).reshape(8, 5), np.zeros(2), ParameterBox(np.ones(2), *np.array([[-9.0] * 2, [9.0] * 2]))
    )
    assert fit.x == pytest.approx(np.linalg.lstsq(A, b, rcond=None)[0], rel=1e-3)


def counted(residual):
    """The same residuals, and a list with an entry for each time they are asked for."""
    calls = []

    def wrapped(x):
        calls.append(x)
        return residual(x)

    return wrapped, calls


def test_slopes_are_measured_again_only_where_steps_do_not_do_what_they_promise():
    noise = np.random.default_rng(0).normal(size=60)
    wrapped, calls = counted(lambda x: ((decay(TRUTH) - decay(x)) / 0.02 + noise).reshape(12, 5))
    fit = gauss_newton(wrapped, TRUTH + 0.1, FREE, iterations=4)
    assert fit.loss < 1.05
    assert len(calls) < 0.7 * (1 + 4 * (3 + 1)), "far fewer than slopes and a step in each of four iterations"


def test_exact_slopes_are_those_where_the_fit_ended(residual):
    fit = gauss_newton(residual, START, FREE, exact=True)
    np.testing.assert_array_equal(fit.J, jacobian(residual, fit.x, fit.z, FREE))


def test_known_slopes_are_not_measured_and_wrong_ones_do_no_harm(residual):
    truth = jacobian(residual, START, residual(START), FREE)
    fits, simulated = [], []
    for slopes in (None, truth[:, :2], np.random.default_rng(0).normal(size=(60, 2))):
        wrapped, calls = counted(residual)
        fits.append(gauss_newton(wrapped, START, FREE, iterations=40, slopes=slopes))
        simulated.append(len(calls))
    assert fits[1].loss == pytest.approx(fits[0].loss, rel=1e-3)
    assert fits[2].loss == pytest.approx(fits[0].loss, rel=1e-3)
    assert simulated[1] <= simulated[0] - 2


def test_a_fit_that_will_not_be_good_enough_is_left_and_another_is_not(residual):
    least = gauss_newton(residual, START, FREE, iterations=40).loss
    wrapped, calls = counted(residual)
    left = gauss_newton(wrapped, START, FREE, iterations=40, good_enough=0.5 * least)
    assert left.given_up and left.loss > 0.5 * least and len(calls) < 40
    kept = gauss_newton(residual, START, FREE, iterations=40, good_enough=1.01 * least)
    assert not kept.given_up and kept.loss == pytest.approx(least, rel=1e-3)


def test_a_hopeless_fit_is_left_before_its_first_step():
    wrapped, calls = counted(lambda x: np.full((4, 5), 9.0) + 0.01 * x[0])
    fit = gauss_newton(wrapped, np.zeros(1), ParameterBox(np.ones(1), np.full(1, -9.0), np.full(1, 9.0)), good_enough=1)
    assert fit.given_up and len(calls) == 2, "where it starts, and one slope"


def test_slopes_of_about_the_same_residuals_lead_to_the_same_minimum_for_fewer_of_the_right_ones(residual):
    (exact, calls), (about, cheap) = counted(residual), counted(lambda x: residual(x) + 3 * np.sin(x[0]))
    fit = gauss_newton(exact, START, FREE, iterations=40, cheaper=about)
    alone, calls_alone = counted(residual)
    assert fit.loss == pytest.approx(gauss_newton(alone, START, FREE, iterations=40).loss, rel=1e-3)
    assert cheap and len(calls) < len(calls_alone)


def test_slopes_that_lead_nowhere_are_given_up(residual):
    fit = gauss_newton(residual, START, FREE, iterations=40, cheaper=lambda x: -residual(x))
    assert fit.loss == pytest.approx(gauss_newton(residual, START, FREE, iterations=40).loss, rel=1e-3)


def test_a_step_corrects_slopes_along_itself_alone():
    rng = np.random.default_rng(0)
    J, step, change = rng.normal(size=(7, 3)), rng.normal(size=3), rng.normal(size=7)
    corrected = broyden(J, step, change)
    assert corrected @ step == pytest.approx(change)
    across = np.cross(step, [1.0, 0, 0])
    assert corrected @ across == pytest.approx(J @ across)


def test_slopes_are_in_units_of_the_scales_and_stay_inside_the_bounds():
    seen = []

    def linear(x):
        seen.append(x)
        return (x * [3.0, 5.0])[None]

    box = ParameterBox(np.array([1.0, 0.1]), np.zeros(2), np.array([1.0, 1.0]))
    J = jacobian(linear, np.array([1.0, 0.5]), linear(np.array([1.0, 0.5])), box)
    assert pytest.approx(np.diag([3.0, 0.5])) == J
    assert all((x <= 1).all() for x in seen), "at its bound a parameter is moved the other way"


def test_hubers_loss_is_square_near_zero_and_smooth_where_it_becomes_linear():
    z = np.array([0.0, 1.0, -2.0])
    assert huber(z).tolist() == [0.0, 1.0, 4.0]
    edge, h = HUBER, 1e-6
    below, above = (huber(np.array([edge, edge + d])) for d in (-h, h))
    assert -np.diff(below) / h == pytest.approx(np.diff(above) / h, rel=1e-5)
    assert huber(np.array([100.0]))[0] == 2 * HUBER * 100 - HUBER**2


def test_weights_make_the_slope_of_squares_that_of_hubers_loss():
    z, h = np.array([-30.0, -5.0, -1.0, 0.5, 4.5, 11.0]), 1e-6
    slope = (huber(z + h) - huber(z - h)) / (2 * h)
    assert 2 * huber_weights(z) * z == pytest.approx(slope, rel=1e-6)


def test_normal_equations_are_the_gradient_and_curvature_of_the_weighted_squares():
    rng = np.random.default_rng(2)
    J, z, w = rng.normal(size=(20, 3)), rng.normal(size=20), rng.uniform(0.1, 1, 20)
    H, g = normal_equations(J, z, w)
    assert pytest.approx(J.T @ np.diag(w) @ J) == H and g == pytest.approx(J.T @ np.diag(w) @ z)


def test_what_is_projected_out_leaves_nothing_of_the_basis():
    rng = np.random.default_rng(3)
    nuisance, v = rng.normal(size=(4, 10, 2)), rng.normal(size=(4, 10, 3))
    rest = project_out(np.linalg.qr(nuisance)[0], v)
    assert np.abs(np.swapaxes(nuisance, 1, 2) @ rest).max() < 1e-12
    alone = project_out(np.linalg.qr(nuisance[0])[0], v[0])
    assert alone == pytest.approx(rest[0]), "the same with and without a batch"
    assert project_out(np.zeros((10, 0)), v[0]) == pytest.approx(v[0]), "nothing to project out"


def test_no_window_is_far_out_of_line_and_all_others_stay_as_they_are():
    J = np.random.default_rng(0).normal(size=(30, 4, 2))
    J[3, :, 0] *= 200
    kept = kept_in_line(J.reshape(120, 2), 30).reshape(J.shape)
    size = np.linalg.norm(J, axis=1)
    others = np.arange(30) != 3
    assert np.array_equal(kept[others], J[others]) and np.array_equal(kept[:, :, 1], J[:, :, 1])
    assert np.linalg.norm(kept[3, :, 0]) == pytest.approx(10 * np.quantile(size[:, 0], 0.9))
    assert np.allclose(kept[3, :, 0] / J[3, :, 0], (kept[3, :, 0] / J[3, :, 0])[0]), "its direction is as it was"


def test_what_few_windows_show_at_all_is_kept():
    J = np.zeros((120, 1))
    J[:4] = 50.0  # an end stop that one of thirty windows meets
    assert kept_in_line(J, 30) is J


def test_a_window_that_jumps_with_the_parameter_does_not_stop_a_fit():
    """29 windows are right at 1; in the last a foot leaves the ground as soon as the parameter moves."""
    rng, slopes = np.random.default_rng(0), np.random.default_rng(1).normal(size=(30, 40))
    noise = rng.normal(size=(30, 40))

    def residual(x):
        z = noise + 2 * slopes * (1 - x[0])
        z[-1] = noise[-1] + np.clip(300 * x[0], -6, 6) * np.sign(slopes[-1])
        return z

    fit = gauss_newton(residual, np.array([0.0]), ParameterBox(np.array([0.1]), np.array([-2.0]), np.array([2.0])))
    assert fit.x[0] == pytest.approx(1.0, abs=0.1)


def test_a_few_windows_out_of_line_do_not_count_and_many_do():
    losses = np.concatenate([np.linspace(0.5, 1.5, 57), [80.0, 300.0]])
    assert usual_windows(losses).tolist() == [True] * 57 + [False] * 2
    assert typical_loss(losses) == pytest.approx(1.0) and losses.mean() > 7
    many = np.concatenate([np.linspace(0.5, 1.5, 50), np.full(9, 80.0)])
    assert usual_windows(many).all() and typical_loss(many) == many.mean(), "so many say that something is missing"
    assert usual_windows(10 * losses[:57]).all(), "what all windows leave is in line, however much it is"
