"""Noise is estimated from recordings, and what the model gets wrong is not taken for it."""

import mujoco
import numpy as np
import pytest
from arm import ARM, NOISE_Q, NOISE_V, record, right_model

from datamodules import Episode, Trajectories
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.noise import estimate_noise, rounding_noise, shrink_to_kind
from idapt_pl.prediction.simulator import Simulator


def test_noise_is_estimated():
    sim, *_ = right_model()
    noise = estimate_noise(sim, (), sample_windows(sim.data, np.arange(12), 2, 2, 200, 0))
    np.testing.assert_allclose(noise.sensors, [NOISE_Q] * 2 + [NOISE_V] * 2, rtol=0.25)


def test_a_sensor_that_counts_has_the_noise_of_rounding_even_at_rest():
    rng, count = np.random.default_rng(0), 2 * np.pi / 4096
    resting = np.round((np.sin(np.linspace(0, 1, 400)) * (np.arange(400) > 300))[:, None] / count) * count
    assert rounding_noise([resting]) == pytest.approx(count / 12**0.5)
    assert rounding_noise([rng.normal(size=(400, 1))]) == 0.0, "no counts, no rounding"


def test_no_sensor_is_taken_to_be_much_better_than_others_of_its_kind():
    model = mujoco.MjModel.from_xml_string(ARM)
    sigma = shrink_to_kind(model, np.array([1e-3, 1e-9, 1e-2, 2e-2]))
    assert sigma == pytest.approx([1e-3, 2.5e-4, 1e-2, 2e-2]), "half the median of the kind"


def test_noise_is_not_mistaken_for_a_missing_effect():
    """What the model gets wrong lasts longer than a control step, and does not count as noise."""
    spec = mujoco.MjSpec.from_string(ARM)
    data, velocities = as_recordings(
        spec.copy().compile(), record(ARM.replace('joint="shoulder"', 'joint="shoulder" gear="0.7"'))
    )
    sim = Simulator(spec, data, velocities)
    noise = estimate_noise(sim, (), sample_windows(data, np.arange(6), 2, 2, 200, 0))
    step = sim.residual((), sample_windows(data, np.arange(6), 1, 1, 200, 0))[:, 0]
    np.testing.assert_allclose(noise.sensors[:2], NOISE_Q, rtol=0.3)
    assert (noise.sensors[2:] < 0.5 * step.std(0)[2:]).all()


CRAWLER = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 0.3"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide"/>
<joint name="pitch" axis="0 1 0"/><geom type="box" size="0.2 0.08 0.05" mass="5"/>
<body name="front" pos="0.2 0 0"><joint name="front" axis="0 1 0" range="-80 80" damping="0.05" armature="0.001"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="0.15"/></body>
<body name="rear" pos="-0.2 0 0"><joint name="rear" axis="0 1 0" range="-80 80" damping="0.05" armature="0.001"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="0.15"/></body></body></worldbody>
<actuator><position joint="front" kp="20" kv="0.5"/><position joint="rear" kp="20" kv="0.5"/></actuator></mujoco>
"""


def test_legs_on_a_floor_do_not_make_noise_look_larger():
    """A light leg between a heavy trunk and a stiff floor answers to tiny changes much as it does to none of a size."""
    model, rng, episodes = mujoco.MjModel.from_xml_string(CRAWLER), np.random.default_rng(0), []
    data = mujoco.MjData(model)
    for _ in range(8):
        mujoco.mj_resetData(model, data)
        rows, commands = [np.concatenate([data.qpos, data.qvel])], rng.uniform(-0.6, 0.6, (10, 2)).repeat(8, 0)
        for u in commands:
            data.ctrl[:] = u
            mujoco.mj_step(model, data, 10)
            rows.append(np.concatenate([data.qpos, data.qvel]))
        seen = np.array(rows) + np.repeat([NOISE_Q, NOISE_V], 5) * rng.normal(size=(81, 10))
        episodes.append(Episode(commands.astype(np.float32), {"qpos": seen[:, :5], "qvel": seen[:, 5:]}))
    recordings, velocities = as_recordings(model, Trajectories(tuple(episodes), 0.02))
    sim = Simulator(mujoco.MjSpec.from_string(CRAWLER), recordings, velocities)
    noise = estimate_noise(sim, (), sample_windows(recordings, np.arange(8), 2, 2, 200, 0))
    assert (noise.sensors < 2 * np.repeat([NOISE_Q, NOISE_V], 5)).all()
