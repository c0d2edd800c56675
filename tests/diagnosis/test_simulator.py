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


def test_channels_of_what_floats_say_which_way():
    xml = """<mujoco><worldbody><body><freejoint name="base"/><geom size="0.1"/>
      <body><joint name="hip"/><geom size="0.1"/><body><joint name="wrist" type="ball"/><geom size="0.1"/></body></body>
    </body></worldbody></mujoco>"""
    data = record(xml, episodes=1)
    names = Simulator(
        mujoco.MjSpec.from_string(xml), *as_recordings(mujoco.MjModel.from_xml_string(xml), data)
    ).channels
    assert names[:7] == ["base x", "base y", "base z", "base about x", "base about y", "base about z", "hip"]
    assert names[7:10] == ["wrist about x", "wrist about y", "wrist about z"] and names[10] == "base x velocity"
