"""Noise is estimated from recordings, and what the model gets wrong is not taken for it."""

import mujoco
import numpy as np
import pytest
from arm import ARM, NOISE_Q, NOISE_V, record, right_model

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
