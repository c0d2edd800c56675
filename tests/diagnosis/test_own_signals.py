"""Actuators with delays, filters or integrators of their own are replayed as MuJoCo simulates them."""

import mujoco
import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.deployment_faults.find import find_deployment_faults
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.effects.own_signals import own_signals, take_signals
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.prediction.data import Recording, Windows, as_recordings, sample_windows
from idapt_pl.prediction.held_commands import HeldCommands

ARM = """<mujoco><option timestep="0.001953125"/><worldbody>
<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0" damping="0.3"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="1" contype="0" conaffinity="0"/>
<body name="b" pos="0 0 -.4"><joint name="k" axis="0 1 0" damping="0.1"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass=".5" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator>{}{}</actuator></mujoco>"""
FILTER = '<general name="{}" joint="{}" gear="{}" dyntype="filterexact" dynprm="{}"/>'
PLAIN = '<motor name="n" joint="k" gear=".5"/>'
ACTUATORS = {
    "plain": ('<motor name="m" joint="j"/>', PLAIN),
    "delay": (  # of whole steps that are powers of two: else MuJoCo's own time decides which of two samples it reads
        '<motor name="m" joint="j" delay=".0390625" nsample="21"/>',
        PLAIN.replace("/>", ' delay=".01953125" nsample="11"/>'),
    ),
    "one filter of two": (FILTER.format("m", "j", 1, 0.1), PLAIN),
    "filters": (
        FILTER.format("m", "j", 1, 0.1).replace("exact", ""),
        FILTER.format("n", "k", 0.5, 0.05).replace("/>", ' actearly="true"/>'),
    ),
    "integrators": [
        f'<intvelocity name="{m}" joint="{j}" kp="{kp}" actrange="-3 3"/>'
        for m, j, kp in (("m", "j", 20), ("n", "k", 10))
    ],
}


def recorded(actuators, episodes=4, steps=150, dt=10 / 512):
    """Recordings of swings that begin with commands of 0, as machines at rest have them."""
    model, rng, made = mujoco.MjModel.from_xml_string(ARM.format(*actuators)), np.random.default_rng(3), []
    for _ in range(episodes):
        d, t = mujoco.MjData(model), dt * np.arange(steps)
        f = rng.uniform(0.3, 2, (4, 2))
        u = 0.8 * np.sin(2 * np.pi * f[:, None] * t[:, None]).sum(0)
        q, v = [d.qpos.copy()], [d.qvel.copy()]
        for a in u:
            d.ctrl[:] = a
            mujoco.mj_step(model, d, round(dt / model.opt.timestep))
            q.append(d.qpos.copy()), v.append(d.qvel.copy())
        seen = {"qpos": q + 1e-3 * rng.normal(size=(steps + 1, 2)), "qvel": v + 1e-2 * rng.normal(size=(steps + 1, 2))}
        made.append(Episode(u, seen))
    return Trajectories(tuple(made), dt)


@pytest.mark.parametrize("actuators", ACTUATORS)
def test_the_right_model_leaves_noise_and_has_no_fault(actuators):
    data, spec = recorded(ACTUATORS[actuators]), mujoco.MjSpec.from_string(ARM.format(*ACTUATORS[actuators]))
    context, state = begin_search(spec, data, candidates=["joint_damping"], threads=1)
    assert np.sqrt(context.loss(state.windows.held_out, ()).mean()) < 1.1
    assert find_deployment_faults(spec, data).faults == ()


@pytest.mark.parametrize("kind", ["filter", "filterexact"])
@pytest.mark.parametrize("early", ["false", "true"])
@pytest.mark.parametrize("divide", [1, 5])
def test_commands_arrive_as_mujocos_filters_pass_them_on(kind, early, divide):
    """Commands that jump every 0.02 s: what arrives in each time step is what MuJoCo makes a force of.

    Also with finer time steps than the model's own, which a search may find.
    """
    filters = [f'<general name="{n}" joint="j" dyntype="{kind}" dynprm="{lag}" actearly="{early}"/>'
               for n, lag in (("a", 0.1), ("b", 0.03), ("c", 0.1))]  # fmt: skip
    spec = mujoco.MjSpec.from_string(
        '<mujoco><option timestep="0.005"/><worldbody><body><joint name="j" type="slide"/><geom size="0.1"/></body>'
        f"</worldbody><actuator>{''.join(filters)}</actuator></mujoco>"
    )
    model = spec.copy().compile()
    model.opt.timestep /= divide
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (20, 3)), 4, 0)
    d, force = mujoco.MjData(model), []
    for a in u:
        d.ctrl[:] = a
        for _ in range(4 * divide):
            mujoco.mj_step(model, d)
            force.append(d.actuator_force.copy())
    data = [Recording("r", 0.02 * np.arange(81), *np.zeros((2, 81, 1)), u)]
    commands = HeldCommands(take_signals(spec)[0].compile(), data, lambda step: own_signals(spec, step))
    half, steps = Windows(np.zeros(1, int), np.array([40]), np.array([40])), 160 * divide
    np.testing.assert_allclose(commands.averaged((), half, steps, 0.005 / divide)[0], force[steps:], atol=1e-3)


def test_windows_begin_once_filters_hold_what_was_commanded_since():
    spec = mujoco.MjSpec.from_string(ARM.format(FILTER.format("m", "j", 1, 0.1), PLAIN))
    data, measured = as_recordings(spec.compile(), recorded((FILTER.format("m", "j", 1, 0.1), PLAIN)))
    assert measured and data[0].start_up == pytest.approx(0.8)
    starts = sample_windows(data, np.arange(len(data)), 5, 5, 10**6, 0).start
    assert starts.min() == int(np.ceil(0.8 / (10 / 512)))


def test_what_actuators_do_to_commands_is_taken_out_of_the_model():
    xml = ARM.format(ACTUATORS["delay"][0], FILTER.format("n", "k", 0.5, 0.1))
    spec = mujoco.MjSpec.from_string(xml)
    plain, taken = take_signals(spec)
    assert taken == (ActuatorDelay("m", 20 / 512), ActuatorLag("n", 0.1, 0.5 / 512))
    assert plain.compile().na == 0 and spec.compile().na == 1, "of a copy"
