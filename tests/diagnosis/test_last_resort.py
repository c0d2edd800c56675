"""What no machine has is named last, with the reason, and only where nothing else will do."""

import mujoco
import numpy as np
import pytest
from arm import ARM, found, record

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.report.diagnosis_wording import verdict_in_words

TURNED = ARM.replace("<option", '<option gravity="-8.26 0 -5.3"')
"""Gravity tilted by 1 rad about y."""
TOSS = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody><geom name="floor" type="plane" size="3 3 1" solref="0.02 {damping}"/>
    <body name="ball" pos="0 0 0.3"><freejoint/>
      <geom name="ball" size="0.05" mass="0.1" solref="0.02 {damping}"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def recordings():
    return record(TURNED)


def test_gravity_on_its_side_is_named_last_and_the_report_says_why(recordings):
    candidates = ["gravity_direction", "joint_damping", "joint_frictionloss"]
    diagnosis, _ = found(recordings, candidates=candidates)
    *others, last = diagnosis.report["effects"]
    assert last["effect"] == "gravity_direction" and not any(e["implausible"] for e in others)
    assert "tilt_y above 0.26 rad is not plausible: machines are set up by eye" in last["implausible"]
    assert last["parameters"]["tilt_y"]["estimate"] == pytest.approx(1.0, abs=0.02)
    words = verdict_in_words(diagnosis.result, diagnosis.sim.model)
    assert any(s.startswith("Direction of gravity is named last: tilt_y above") for s in words)


def test_another_simulation_may_be_anything(recordings):
    settings = SearchSettings(plausible=False)
    _, effects = found(recordings, candidates=["gravity_direction", "joint_damping"], settings=settings)
    assert [name for name, _ in effects] == ["gravity_direction"]
    assert not effects["gravity_direction", "world"]["implausible"]


def test_a_ball_that_bounces_is_found_without_any_actuator():
    model, rng, episodes = mujoco.MjModel.from_xml_string(TOSS.format(damping=0.15)), np.random.default_rng(0), []
    for _ in range(8):
        data = mujoco.MjData(model)
        data.qpos[2], data.qvel[:] = rng.uniform(0.1, 0.4), rng.uniform(-1, 1, 6)
        q, v = [data.qpos.copy()], [data.qvel.copy()]
        for _ in range(60):
            mujoco.mj_step(model, data, 2)
            q.append(data.qpos.copy()), v.append(data.qvel.copy())
        noise = rng.normal(size=(61, 13))
        seen = {"qpos": np.array(q), "qvel": np.array(v) + 1e-2 * noise[:, :6]}
        seen["qpos"] += 5e-4 * noise[:, 6:]
        seen["qpos"][:, 3:] /= np.linalg.norm(seen["qpos"][:, 3:], axis=1, keepdims=True)
        episodes.append(Episode(np.zeros((60, 0), np.float32), seen))
    nominal = mujoco.MjSpec.from_string(TOSS.format(damping=1))
    report = diagnose(
        nominal, Trajectories(tuple(episodes), 0.01), candidates=["contact_softness", "contact_friction", "fluid_drag"]
    ).report
    (only,) = [e for e in report["effects"] if e["effect"] != "numerics"]
    assert (only["effect"], only["target"], report["verdict"]) == ("contact_softness", "*", "effects_found")
    assert only["parameters"]["damping_ratio"]["estimate"] == pytest.approx(0.15, abs=0.01)
