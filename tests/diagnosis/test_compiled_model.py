"""Law: what is switched off to save time moves nothing, and many steps side by side are MuJoCo's own steps."""

import mujoco
import numpy as np
import pytest

from idapt_pl.prediction.compiled_model import can_touch, for_motion_alone
from idapt_pl.prediction.rolling import roll

# Everything overlaps, so geoms that can touch do.
MODEL = """
<mujoco><option {option}/><worldbody>{floor}
  <body name="one"><joint name="a" axis="0 1 0"/><geom name="big" size="0.2" {one}/>
    <body name="two" pos="0.1 0 0"><joint axis="0 1 0"/><geom size="0.2" {two}/>
      <body pos="0.1 0 0"><geom size="0.2" contype="0" conaffinity="0"/>
        <body name="three" pos="0.1 0 0"><joint axis="0 1 0"/><geom size="0.2" {three}/></body></body></body></body>
</worldbody>{more}
<actuator><motor joint="a"/></actuator><sensor><framepos objtype="body" objname="two"/></sensor></mujoco>
"""
NONE = {"option": "", "floor": "", "one": "", "two": "", "three": "", "more": ""}
NO_BITS = dict.fromkeys(("one", "two", "three"), 'contype="0" conaffinity="0"')
FLOOR = '<geom type="plane" size="1 1 1"/>'


@pytest.mark.parametrize(
    ("changes", "touches"),
    [
        ({"one": NO_BITS["one"]}, False),  # two and three are neighbours: a welded link counts as what carries it
        ({}, True),  # one and three
        (NO_BITS, False),
        (NO_BITS | {"floor": FLOOR}, False),
        ({"two": NO_BITS["two"], "three": NO_BITS["three"], "floor": FLOOR}, True),
        ({"one": 'contype="2" conaffinity="4"', "three": 'contype="4" conaffinity="8"'}, True),
        ({"one": 'contype="2" conaffinity="0"', "three": 'contype="4" conaffinity="0"'}, False),
        (NO_BITS | {"more": '<contact><pair geom1="big" geom2="b"/></contact>', "three": 'name="b"'}, True),
    ],
)
def test_what_can_touch_is_what_mujoco_finds_where_everything_overlaps(changes, touches):
    model = mujoco.MjModel.from_xml_string(MODEL.format(**(NONE | changes)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (data.ncon > 0) == touches == can_touch(model)


@pytest.mark.parametrize("changes", [{}, {"floor": FLOOR}, NO_BITS, {"option": 'integrator="RK4"'}])
@pytest.mark.parametrize("rooms", [1, 2])
@pytest.mark.parametrize("held", [None, 1, 3])
def test_rolled_states_are_those_of_mujocos_own_steps(changes, rooms, held):
    plain = mujoco.MjModel.from_xml_string(MODEL.format(**(NONE | changes)))
    model = for_motion_alone(mujoco.MjModel.from_xml_string(MODEL.format(**(NONE | changes))))
    rng, n, steps = np.random.default_rng(0), 3, 7
    start = np.zeros((n, 1 + model.nq + model.nv))
    start[:, 1:] = rng.normal(size=(n, model.nq + model.nv))
    controls, push = rng.normal(size=(n, steps, 1)), rng.normal(size=(n, steps, 2))

    def forces_at(states, commands):  # depends on where everything is
        forces = np.zeros((len(states), model.nv + 6 * model.nbody))
        forces[:, 1], forces[:, model.nv + 6 : model.nv + 9] = np.sin(states[:, 2]) + commands[:, 0], (1, 2, 3)
        return forces

    data = [mujoco.MjData(model) for _ in range(rooms)]
    states = roll(model, data, start, controls, push, forces_at, held)
    assert states.shape == (n, steps + 1, start.shape[1])
    for i in range(n):
        d = mujoco.MjData(plain)
        mujoco.mj_setState(plain, d, start[i], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        for k in range(steps):
            now = np.concatenate([[d.time], d.qpos, d.qvel])
            np.testing.assert_allclose(states[i, k], now, rtol=1e-9, atol=1e-9)
            if k % (held or steps) == 0:
                forces = forces_at(now[None], controls[i, k : k + 1])[0]
            d.ctrl[:] = controls[i, k]
            d.qfrc_applied[:] = forces[: plain.nv]
            d.qfrc_applied[:2] += push[i, k]
            d.xfrc_applied[:] = forces[plain.nv :].reshape(-1, 6)
            mujoco.mj_step(plain, d)
