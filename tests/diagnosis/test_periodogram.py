"""How many periods a torque has in a turn is read off the residual."""

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.candidates.periodogram import highest_peaks, mean_cosine, mean_sine, periodic_starts
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointCogging
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.simulator import Simulator

WHEEL = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody><body name="wheel"><joint name="axle" axis="0 0 1" damping="0.02"/>
    <geom type="cylinder" size="0.1 0.01" mass="1" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="motor" joint="axle"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("n", [1.0, 9.0])
def test_means_over_a_stretch_are_integrals(n):
    a, b = 0.3, 0.7
    x = np.linspace(a, b, 20001)
    assert mean_sine(n, np.array([a, b])) == pytest.approx(np.sin(n * x).mean(), abs=1e-4)
    assert mean_cosine(n, np.array([a, b])) == pytest.approx(np.cos(n * x).mean(), abs=1e-4)
    assert mean_sine(n, np.array([a, a])) == pytest.approx(np.sin(n * a))


def test_peaks_are_local_maxima_and_the_highest_comes_first():
    assert highest_peaks(np.array([0.0, 2.0, 1.0, 5.0, 4.0])) == [3, 1]


@pytest.mark.parametrize(("periods", "phase"), [(9, 0.0), (14, 1.2)])
def test_a_torque_that_repeats_is_found_with_its_amplitude(periods, phase):
    model, rng, episodes = mujoco.MjModel.from_xml_string(WHEEL), np.random.default_rng(periods), []
    for _ in range(4):
        data, actions = mujoco.MjData(model), np.repeat(rng.normal(size=(10, 1)), 8, 0) * 0.05
        q, v = [data.qpos.copy()], [data.qvel.copy()]
        for a in actions:
            for _ in range(4):
                data.ctrl[:] = a
                data.qfrc_applied[0] = 0.01 * np.sin(periods * data.qpos[0] + phase)
                mujoco.mj_step(model, data)
            q.append(data.qpos.copy()), v.append(data.qvel.copy())
        episodes.append(Episode(actions.astype(np.float32), {"qpos": np.array(q), "qvel": np.array(v)}))
    recordings, velocities = as_recordings(model, Trajectories(tuple(episodes), 0.02))
    sim = Simulator(mujoco.MjSpec.from_string(WHEEL), recordings, velocities, threads=1)
    windows = sample_windows(recordings, np.arange(4), 5, 5, 60, 0)
    base, span = sim.residual((), windows), ((-1e4, 1e4), (-1e4, 1e4), (2.0, 40.0))
    names = ("sine", "cosine", "periods")
    c = Candidate(JointCogging, "axle", names, (0.0, 0.0, 6.0), (0.01, 0.01, 0.1), span=span, strength=2)
    starts = periodic_starts(sim, windows, c, base.ravel(), lambda e: (sim.residual((e,), windows) - base).ravel())
    sine, cosine, n = starts[0]
    assert n == pytest.approx(periods, abs=0.3)
    assert np.hypot(sine, cosine) == pytest.approx(0.01, rel=0.2)
