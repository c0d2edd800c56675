"""Recordings without velocities: what a window begins with is hardly known, and what is found is right all the same."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction import noise
from idapt_pl.prediction.data import as_recordings, sample_windows, slope_reach, slopes
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.prediction.whitening import initial_sensitivity, whiten, whitener

CART = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/><geom size="0.1" mass="1"/>
    <body name="pole"><joint name="hinge" axis="0 1 0" damping="0.01"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.6" mass="5" contype="0" conaffinity="0"/></body>
  </body></worldbody>
  <actuator><motor name="push" joint="slide" gear="{gear}" ctrlrange="-1 1"/></actuator>
</mujoco>"""
DT, SKIP, NOISE = 0.04, 20, 2e-4


def recordings(gear, seed, episodes=20, steps=24, skip=SKIP, noise=NOISE):
    """Positions of a cart with a pole on it, pushed about, 25 times a second: it bends much between two samples."""
    model, rng = mujoco.MjModel.from_xml_string(CART.format(gear=gear)), np.random.default_rng(seed)
    made = []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[1] = rng.normal() * 0.1
        actions, rows = np.repeat(rng.uniform(-1, 1, (steps // 3, 1)), 3, 0), [data.qpos.copy()]
        for a in actions:
            data.ctrl[:] = a
            mujoco.mj_step(model, data, skip)
            rows.append(data.qpos.copy())
        seen = np.array(rows) + noise * rng.normal(size=(steps + 1, model.nq))
        made.append(Episode(actions.astype(np.float32), {"qpos": seen}))
    return Trajectories(tuple(made), 0.002 * skip)


def gain_found(seed):
    spec = mujoco.MjSpec.from_string(CART.format(gear=100))
    diagnosis = diagnose(
        spec, recordings(85, seed), threads=1, candidates=["actuator_gain", "joint_damping"], laws=False
    )
    (effect,) = diagnosis.result.effects
    assert effect.key == ("actuator_gain", "push")
    return effect.parameters["gain"]


def test_a_gain_is_within_its_interval(monkeypatch):
    found = [gain_found(seed) for seed in range(3)]
    assert [g.estimate for g in found] == pytest.approx([0.85] * 3, rel=8e-3)
    assert sum(g.ci95[0] <= 0.85 <= g.ci95[1] for g in found) >= 2
    monkeypatch.setattr(noise, "BENT", 0.0)
    at_their_word = [gain_found(seed) for seed in range(3)]
    worst = [max(abs(g.estimate - 0.85) for g in each) for each in (found, at_their_word)]
    assert worst[0] < 0.5 * worst[1], "slopes taken at their word mislead"


SHAKY = {"skip": 5, "noise": 1e-3}


@pytest.mark.parametrize("seed", range(3))
def test_the_noise_of_the_positions_is_estimated_as_it_is_and_the_right_model_leaves_noise(seed):
    """Three short episodes: a slope shares its noise with positions that are compared, and that is allowed for."""
    spec = mujoco.MjSpec.from_string(CART.format(gear=85))
    context, state = begin_search(spec, recordings(85, seed, 3, 60, **SHAKY), threads=1)
    assert state.windows.noise.sensors == pytest.approx([1e-3, 1e-3], rel=0.3)
    assert state.windows.noise.slope == noise.SlopeOfPositions(1, pytest.approx(0.02))
    assert context.loss(state.windows.fit, ()).mean() == pytest.approx(1.0, abs=0.35)


def test_whitened_rows_of_the_right_model_are_white_only_if_what_they_share_is_known():
    """A pole that swings gently: slopes are not bent, but have the noise of positions that are compared."""
    spec = mujoco.MjSpec.from_string(CART.format(gear=1e-3))
    data, measured = as_recordings(spec.copy().compile(), recordings(1e-3, 0, 40, 60, **SHAKY))
    sim, windows = Simulator(spec, data, measured, threads=1), sample_windows(data, np.arange(40), 5, 5, 1000, 0)
    sensors, slope = np.full(2, 1e-3), noise.slope_of(data)
    start = np.concatenate([sensors, 2**0.5 * sensors / slope.seconds])
    at, residual = initial_sensitivity(sim, (), windows, start), sim.residual((), windows)

    def by(slope):
        z = whiten(whitener(at, noise.Noise(sensors, start, slope=slope), sim.compared, windows.offsets), residual)
        return np.abs(np.cov(z.T) - np.eye(z.shape[1])).max()

    assert by(slope) < 5 * (2 / len(windows)) ** 0.5 < by(None)


@pytest.mark.parametrize("period", [0.004, 0.04])
def test_how_much_a_slope_is_bent_is_known_at_every_control_period(period):
    """A sine's central slope is wrong by h²ω²/6 of it, h being the reach in time."""
    time, omega = period * np.arange(400), 0.5 / period
    qpos = np.stack([np.sin(omega * time), np.zeros_like(time)], 1)
    model = mujoco.MjModel.from_xml_string(CART.format(gear=100))

    def bending(qpos):
        given = Trajectories((Episode(np.zeros((399, 1), np.float32), {"qpos": qpos}),), period)
        data, measured = as_recordings(model, given)
        assert not measured
        return noise.slope_bending(SimpleNamespace(model=model, data=data))[0]

    wrong = slopes(model, time, qpos)[5:-5, 0] - omega * np.cos(omega * time)[5:-5]
    assert slope_reach(time) == (2 if period == 0.004 else 1)
    bent = bending(qpos)
    assert bent == pytest.approx(np.std(wrong), rel=0.5)
    assert bending(2 * qpos) == pytest.approx(2 * bent)
