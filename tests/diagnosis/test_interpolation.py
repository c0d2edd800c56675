"""Between time steps a simulation is where one with finer steps is, whatever its joints are."""

import mujoco
import numpy as np

from idapt_pl.prediction.interpolation import interpolate_states
from idapt_pl.prediction.rolling import STATE

XML = """<mujoco><option timestep="{}" gravity="0 0 -9.81" integrator="RK4"/><worldbody>
<body name="free"><freejoint/><geom size="0.1 0.2 0.3" type="box" mass="1"/>
<body pos="0 0 0.3"><joint axis="0 1 0"/><geom size="0.02 0.02 0.1" type="box" mass="0.1"/></body></body>
<body pos="2 0 0"><joint type="ball"/><geom size="0.02 0.02 0.1" pos="0 0 -0.2" type="box" mass="0.1"/></body>
</worldbody></mujoco>"""


def simulated(step, seconds=0.04):
    model = mujoco.MjModel.from_xml_string(XML.format(step))
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv)
    states = []
    for _ in range(round(seconds / step) + 1):
        state = np.zeros(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        states.append(state)
        mujoco.mj_step(model, data)
    return model, np.array(states)


def test_places_and_rotations_between_steps_are_those_of_a_finer_simulation():
    coarse, states = simulated(4e-3)
    _, fine = simulated(5e-4)
    at = 5e-4 * np.arange(0, 80)
    qpos, qvel = interpolate_states(coarse, states[None], at[None])
    np.testing.assert_allclose(qpos[0], fine[:80, 1 : 1 + coarse.nq], atol=2e-5)
    np.testing.assert_allclose(qvel[0], fine[:80, 1 + coarse.nq : 1 + coarse.nq + coarse.nv], atol=2e-3)
    whole = interpolate_states(coarse, states[None], 4e-3 * np.arange(10)[None])
    np.testing.assert_array_equal(whole[0][0], states[:10, 1 : 1 + coarse.nq])
