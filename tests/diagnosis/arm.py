"""Recordings of a simulated arm, with what may be hidden in it, for the tests of the diagnosis."""

import functools

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.data import as_recordings, sample_windows
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.prediction.whitening import initial_sensitivity

ARM = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom name="u" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.6" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.02"/>
        <geom name="l" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.4" contype="0" conaffinity="0"/>
      </body></body>
  </worldbody>
  <actuator><motor name="s" joint="shoulder"/><motor name="e" joint="elbow"/></actuator>
</mujoco>"""
NOISE_Q, NOISE_V, DT, SKIP = 1e-3, 1e-2, 0.02, 5


def record(
    xml=ARM, delay=0, push=None, episodes=6, steps=80, size=1.0, velocities=True, seed=0, noise=(NOISE_Q, NOISE_V),
    skip=SKIP,
):  # fmt: skip
    """Recordings of an arm: commands late by whole physics steps, ``push(time)`` a torque on the shoulder.

    ``skip``: physics steps of a control step.
    """
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(seed)
    made = []
    for _ in range(episodes):
        data = mujoco.MjData(model)
        data.qpos[:], queue = rng.normal(size=model.nq) * 0.3, [np.zeros(model.nu)] * delay
        actions = size * np.repeat(rng.normal(size=(steps // 4, model.nu)), 4, 0).clip(-1, 1)
        q, v = [data.qpos.copy()], [data.qvel.copy()]
        for a in actions:
            for _ in range(skip):
                queue.append(a)
                data.ctrl[:] = queue.pop(0)
                data.qfrc_applied[0] = push(data.time) if push else 0.0
                mujoco.mj_step(model, data)
            q.append(data.qpos.copy()), v.append(data.qvel.copy())
        seen = {"qpos": np.array(q) + noise[0] * rng.normal(size=(steps + 1, model.nq))}
        if velocities:
            seen["qvel"] = np.array(v) + noise[1] * rng.normal(size=(steps + 1, model.nv))
        made.append(Episode(actions.astype(np.float32), seen))
    return Trajectories(tuple(made), DT)


def found(data, **settings):
    diagnosis = diagnose(mujoco.MjSpec.from_string(ARM), data, **settings)
    return diagnosis, {(e["effect"], e["target"]): e for e in diagnosis.report["effects"]}


@functools.cache
def right_model():
    """A simulator with the right model, its windows, residuals and sensitivities."""
    spec, trajectories = mujoco.MjSpec.from_string(ARM), record(episodes=12)
    data, velocities = as_recordings(spec.copy().compile(), trajectories)
    sim = Simulator(spec, data, velocities)
    windows = sample_windows(data, np.arange(12), 5, 5, 1000, 0)
    residual = sim.residual((), windows)
    size = np.repeat([NOISE_Q, NOISE_V], 2)
    return sim, windows, residual, initial_sensitivity(sim, (), windows, size)
