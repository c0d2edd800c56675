"""Separations are those that a likelihood ratio would show, and nothing where there is nothing to tell apart."""

import numpy as np
import pytest
from arms import ARMATURE, DAMPING, FORCE, FRICTION, NOISE, OFFSET, RAIL, explained, forecaster, left_open

from idapt_pl.diagnosis.answer.explanation import Measurement, Standing
from idapt_pl.diagnosis.candidates.fit import fit_candidates
from idapt_pl.effects.joints import JointDamping
from idapt_pl.excitation.criterion import SeparationCriterion
from idapt_pl.excitation.forecast import coarse
from idapt_pl.excitation.limits import ImpossibleMotion
from idapt_pl.excitation.motion import fourier_motion
from idapt_pl.prediction.side_by_side import SideBySide


def criterion(*explanations, xml=None, noise=NOISE):
    given = {} if xml is None else {"xml": xml}
    made = SeparationCriterion(forecaster(*explanations, **given), left_open(*explanations, **given).rivals, noise)
    made.calibrate(motions(3, made.forecast.model.nu))
    return made


def motions(n, nu=1, size=0.6, steps=150):
    motion = fourier_motion(np.zeros((steps, nu)), np.tile([-size, size], (nu, 1)), 0.02, 3.0)
    return motion.commands(2 * motion.random(np.random.default_rng(0), n))


def test_larger_motions_tell_more_and_quieter_sensors_too():
    friction = criterion(DAMPING, FRICTION)
    u = motions(4)
    loud, soft = friction(u).separations[:, 0], friction(0.3 * u).separations[:, 0]
    assert (loud > soft).all() and loud.max() > 5
    quieter = Measurement(0.02, 5, True, (5e-4, 5e-3), (5e-4, 5e-3))
    assert criterion(DAMPING, FRICTION, noise=quieter)(u).separations[:, 0] == pytest.approx(2 * loud, rel=0.05)


def test_an_explanation_is_not_apart_from_itself_nor_from_its_twin():
    assert criterion(DAMPING, DAMPING)(motions(2)).separations == pytest.approx(0, abs=1e-6)
    twins = criterion(OFFSET, FORCE, xml=RAIL)
    assert twins(motions(3)).separations.max() < 0.1
    assert twins.after_refit(motions(1)[0]).max() < 0.1


def test_separations_do_not_depend_on_threads():
    def seen(threads):
        made = criterion(DAMPING, FRICTION, ARMATURE)
        made.forecast.sim.threads = threads
        made.forecast.sim.side_by_side = SideBySide(threads)
        return made(motions(3)).separations, made.after_refit(motions(1)[0])

    for one, three in zip(seen(1), seen(3), strict=True):
        assert np.array_equal(one, three) and one.max() > 1


def test_what_a_refit_explains_does_not_count():
    """Two values of the same damping: the recordings differ by far, but one parameter explains it all."""
    other = explained(Standing.EQUIVALENT, JointDamping("shoulder", 0.5), damping=(0.2, 0.2))
    same_kind, u = criterion(DAMPING, other), motions(1)
    apart = same_kind.residuals(u)[1]
    assert np.linalg.norm(apart[0] - apart[1]) > 20
    assert same_kind(u).separations.max() < 0.1 * np.linalg.norm(apart[0] - apart[1])
    assert same_kind.after_refit(u[0]).max() < 1.0


def test_the_quick_number_is_of_the_order_of_that_after_a_refit():
    friction, u = criterion(DAMPING, FRICTION, ARMATURE), motions(1)
    ratio = friction(u).separations[0] / friction.after_refit(u[0])
    assert (ratio > 0.4).all() and (ratio < 2.5).all()  # it is linear, and on the trajectory of the first alone


def noisy_recording(made, u, rng):
    """What the first explanation predicts of a motion, with the sensors' noise; and the windows in it."""
    seen = made.forecast(coarse(made.rivals[0]), u)
    windows, recording = made.windows(seen, u), seen.recordings(u)[0]
    recording.qpos[:] += 1e-3 * rng.standard_normal(recording.qpos.shape)
    recording.qvel[:] += 1e-2 * rng.standard_normal(recording.qvel.shape)
    return made.forecast.sim.replaying([recording]), windows


def test_a_likelihood_ratio_shows_the_predicted_separation():
    """With noisy recordings of one explanation, the other one, fitted again, leaves D² more on average."""
    made, u, rng = criterion(DAMPING, FRICTION), motions(1, size=0.3), np.random.default_rng(0)
    truth, other = made.rivals
    D, left, gains = np.sqrt(np.square(made.left_by_others(0, u)).sum()), [], []
    for _ in range(10):
        sim, windows = noisy_recording(made, u, rng)

        def whitened(effects, sim=sim, windows=windows):
            return sim.residual(effects, windows).reshape(len(windows), -1) @ made.W.T

        left.append(np.square(whitened(coarse(truth))))
        fit = fit_candidates(whitened, other.fixed, other.candidates, other.x, 4)
        gains.append(np.square(fit.solution.z).sum() - left[-1].sum())
    assert np.mean(left) == pytest.approx(1.0, abs=0.1)  # white, of variance 1, under the truth
    assert np.mean(gains) == pytest.approx(D**2, rel=0.3)


def test_separation_grows_over_a_motion_up_to_its_whole():
    made, u = criterion(DAMPING, FRICTION), motions(1)
    ends, apart = made.growth(u)
    assert (np.diff(ends) > 0).all() and (np.diff(apart[0]) >= -1e-9).all()
    assert apart[0, -1] == pytest.approx(made(u).separations[0, 0])


def test_information_is_that_of_the_damping():
    """The interval that it promises is what estimates from noisy recordings scatter by."""
    made, u = criterion(DAMPING), motions(1)
    F = made(u).information[0, 0, 0]
    c, x = made.rivals[0].candidates[0], made.rivals[0].x[0]
    rng, estimates = np.random.default_rng(0), []
    for _ in range(30):
        sim, windows = noisy_recording(made, u, rng)
        z0, z1 = (
            (sim.residual((c.effect(v),), windows).reshape(len(windows), -1) @ made.W.T).ravel() for v in (x, x + 0.01)
        )
        slope = (z1 - z0) / 0.01
        estimates.append(-(slope @ z0) / (slope @ slope))
    assert np.std(estimates) == pytest.approx(c.scale[0] / np.sqrt(F), rel=0.4)


def test_a_pose_that_is_not_held_is_refused():
    drifting = RAIL.replace('stiffness="8"', "").replace('range="-1 1"', 'range="-9 9"').replace('"2"', '"0.1"')
    with pytest.raises(ImpossibleMotion, match="does not rest at the start pose"):
        forecaster(OFFSET, xml=drifting)
