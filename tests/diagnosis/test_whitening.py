"""Whitened residuals of the right model are white."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import NOISE_Q, NOISE_V, right_model

from datamodules import Episode, Trajectories
from idapt_pl.estimation.least_squares import robust_loss
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.prediction.whitening import initial_sensitivity, whiten, whitener


def test_residuals_of_the_right_model_are_white_after_whitening():
    sim, windows, residual, at = right_model()
    z = whiten(whitener(at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), sim.compared, windows.offsets), residual)
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)
    correlation = np.corrcoef(z.T) - np.eye(z.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(len(z))


def test_what_was_not_measured_does_not_count_and_the_rest_is_white_without_it():
    _, windows, residual, at = right_model()
    elsewhere = residual.copy()
    elsewhere[..., 0] += 1e3
    W = whitener(
        at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), np.array([False, True, True, True]), windows.offsets
    )
    z = whiten(W, residual)
    assert z.shape[1] == 3 * residual.shape[1] and np.array_equal(z, whiten(W, elsewhere))
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)


STICK = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body pos="0 0 0.3">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="-0.2 0 0 0.2 0 0" mass="0.5"/>
    </body>
  </worldbody>
</mujoco>"""


def test_rows_stay_near_white_where_one_strike_leads_to_the_next():
    """A stick that tumbles: when one end strikes decides how the other does."""
    model, rng, made = mujoco.MjModel.from_xml_string(STICK), np.random.default_rng(0), []
    for _ in range(40):
        d, rows = mujoco.MjData(model), []
        d.qpos[2], d.qvel[:] = rng.uniform(-1, 1), rng.normal(size=3) * (0.5, 0.5, 4)
        for _ in range(40):
            rows.append(np.concatenate([d.qpos, d.qvel]))
            mujoco.mj_step(model, d, 10)
        rows = np.array(rows) + np.repeat([NOISE_Q, NOISE_V], 3) * rng.normal(size=(40, 6))
        made.append(Episode(np.zeros((39, 0), np.float32), {"qpos": rows[:, :3], "qvel": rows[:, 3:]}))
    data, measured = as_recordings(model, Trajectories(tuple(made), 0.02))
    sim, windows = (
        Simulator(mujoco.MjSpec.from_string(STICK), data, measured),
        sample_windows(data, np.arange(40), 18, 6, 300, 0),
    )
    size = np.repeat([NOISE_Q, NOISE_V], 3)
    at, residual = initial_sensitivity(sim, (), windows, size), sim.residual((), windows)

    def robust(at):
        return robust_loss(whiten(whitener(at, Noise(size, size), sim.compared, windows.offsets), residual)).mean()

    assert robust(at) < 1.1
    assert robust(replace(at, rest=0 * at.rest)) > 1.25, "slopes and bends along each coordinate do not tell"


def test_where_motion_is_smooth_few_states_are_drawn_and_they_show_nothing():
    *_, at = right_model()
    size = np.repeat([NOISE_Q, NOISE_V], 2)
    assert at.rest.shape[-1] == 4 and np.abs(at.rest / size).max() < 0.05
    sim, windows, *_ = right_model()
    without = initial_sensitivity(sim, (), windows, size, draw=False)
    assert without.rest.shape[-1] == 0 and np.array_equal(without.slope, at.slope)
