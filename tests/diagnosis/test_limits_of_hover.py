"""Limits of motors that always push: commands lie about what holds the machine, and a limit a little above it."""

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.candidates.listing import typical_sizes
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.effects.actuators import ActuatorSaturation, levels
from idapt_pl.prediction.data import as_recordings

LIFT = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody><body name="cabin"><joint name="lift" type="slide" axis="0 0 1" damping="0.5"/>
    <geom type="sphere" size="0.1" mass="1"/></body></worldbody>
  <actuator><motor name="winch" joint="lift" ctrlrange="0 40" ctrllimited="true"/></actuator>
</mujoco>"""
HOLDS, SWING, DT = 9.81, 1.2, 0.02


def recorded(limit, seed=0):
    """Episodes under commands about what holds the cabin, cut off at a limit in truth."""
    model, rng, made = mujoco.MjModel.from_xml_string(LIFT), np.random.default_rng(seed), []
    for _ in range(8):
        data, commands = mujoco.MjData(model), HOLDS + SWING * np.repeat(rng.normal(size=(20, 1)), 4, 0).clip(-2, 2)
        q, v = [0.0], [0.0]
        for u in commands:
            data.ctrl[:] = np.minimum(u, limit)
            mujoco.mj_step(model, data, 4)
            q.append(data.qpos[0]), v.append(data.qvel[0])
        noise = rng.normal(size=(2, 81, 1)) * np.array([5e-4, 5e-3])[:, None, None]
        seen = {"qpos": np.array(q)[:, None] + noise[0], "qvel": np.array(v)[:, None] + noise[1]}
        made.append(Episode(commands.astype(np.float32), seen))
    return Trajectories(tuple(made), DT)


@pytest.mark.parametrize("limit", [HOLDS + 0.8 * SWING, HOLDS + 1.3 * SWING])
def test_a_limit_a_little_above_what_holds_is_found(limit):
    report = diagnose(mujoco.MjSpec.from_string(LIFT), recorded(limit), laws=False).report
    (effect,) = (e for e in report["effects"] if e["effect"] != "numerics")
    assert effect["effect"] == "actuator_saturation" and report["verdict"] == "effects_found"
    assert effect["parameters"]["limit"]["estimate"] == pytest.approx(limit, abs=0.05 * SWING)


def test_none_is_found_where_there_is_none():
    report = diagnose(mujoco.MjSpec.from_string(LIFT), recorded(np.inf), laws=False).report
    assert not report["effects"] and report["verdict"] == "no_missing_effect"


def test_fits_begin_within_what_was_commanded():
    model, data = mujoco.MjModel.from_xml_string(LIFT), recorded(np.inf)
    sizes = typical_sizes(model, as_recordings(model, data)[0], 0.2)
    candidate, *_ = ActuatorSaturation.candidates(model, sizes)
    commands = np.concatenate([e.actions for e in data])
    assert all(np.quantile(commands, 0.1) < start < commands.max() for (start,) in candidate.starts)


def test_levels_of_a_signal_about_zero_are_shares_of_its_rms():
    """Its magnitudes have a mean of 0.8 rms and a spread of 0.6, and so has a half normal distribution."""
    magnitudes = np.abs(np.random.default_rng(0).normal(size=100_000))
    assert np.ravel(levels(1.0, magnitudes.std(), (-0.5, 1.0))) == pytest.approx([0.5, 1.4], abs=0.01)
