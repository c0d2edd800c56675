"""Predictions of measured windows."""

import mujoco
import numpy as np
from arm import ARM, record

from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.simulator import Simulator


def test_without_noise_the_right_model_predicts_the_recording():
    """Controls are held as they were: a prediction from exact states is exact."""
    trajectories = record(episodes=2, noise=(0.0, 0.0))
    spec = mujoco.MjSpec.from_string(ARM)
    data, velocities = as_recordings(spec.copy().compile(), trajectories)
    sim = Simulator(spec, data, velocities)
    windows = sample_windows(data, np.arange(2), 5, 5, 1000, 0)
    assert np.abs(sim.residual((), windows)).max() < 1e-5  # actions are float32
    late = sim.residual((ActuatorDelay("*", 0.01),), windows)
    assert np.abs(late).max() > 1e-3
