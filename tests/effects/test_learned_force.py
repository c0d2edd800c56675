"""Formulas of forces: what they may say, what they come to, and that simulations feel them."""

import itertools

import mujoco
import numpy as np
import pytest

from idapt_pl.effects import Domain, effect_from_dict
from idapt_pl.effects.acting import ActingForces, MotionNow, advance, register_laws
from idapt_pl.effects.expression import parse_expression
from idapt_pl.effects.learned import LearnedForce, ResidualNetwork

PENDULUM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody><body name="rod"><joint name="axis" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="1"/></body></worldbody>
  <actuator><motor name="axis" joint="axis" gear="2"/></actuator>
</mujoco>"""
NONE = np.zeros((3, 0))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-a*tanh(v/b)*abs(load)", -2.0 * np.tanh(np.array([1.0, -2.0, 0.0]) / 0.5) * 3.0),
        ("(a + q)**2 - 1", np.array([8.0, 3.0, 24.0])),
        ("positive(-v)*1e1", np.array([0.0, 20.0, 0.0])),
        ("a/v", np.array([2.0, -1.0, 0.0])),  # what cannot be divided adds nothing
    ],
)
def test_a_formula_comes_to_what_it_says(text, expected):
    values = {"v": np.array([1.0, -2.0, 0.0]), "q": np.array([1.0, 0.0, 3.0]), "load": np.full(3, -3.0)}
    values |= {"a": np.asarray(2.0), "b": np.asarray(0.5)}
    np.testing.assert_allclose(np.broadcast_to(parse_expression(text).value(values, NONE), 3), expected)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "q.real", "q[0]", "[q for q in v]", "lambda: q", "a if q else b", "q @ v",
        "exec(q)", "q**v", "True*q", "'q'", "x + q", "sin(q, v)", "sin(q=1)", "lowpass(q)", "lowpass(motor, 0.1)",
        "lowpass(lowpass(q, 1), 1)", "hysteresis(v)", "q;v", "q = 1", "", "1e400*q", "q" * 500, "(" * 150 + "q",
    ],
)  # fmt: skip
def test_what_is_not_in_the_grammar_is_refused_in_words(text):
    with pytest.raises(ValueError, match="formula") as error:
        parse_expression(text)
    assert len(str(error.value)) < 900


def test_a_lowpass_follows_an_exponential_and_hysteresis_turns_back_on_the_other_branch():
    slow, bent = parse_expression("lowpass(u, 0.2)"), parse_expression("hysteresis(0.1)")
    memory, one = np.zeros((1, 1)), np.ones(1)
    for _ in range(10):
        memory = slow.step({"u": one}, {"u": one}, memory, 0.02)
    assert memory[0, 0] == pytest.approx(1 - np.exp(-1.0))
    memory, path = np.zeros((1, 1)), [0.0, 0.05, 0.5, 0.45]
    seen = []
    for before, now in itertools.pairwise(path):
        memory = bent.step({"q": before * one}, {"q": now * one}, memory, 0.01)
        seen.append(memory[0, 0])
    assert seen[0] == pytest.approx(1 - np.exp(-0.5)) and seen[1] > 0.98 and abs(seen[2]) < 0.3


def test_coefficients_must_be_those_of_the_formula():
    with pytest.raises(ValueError, match="coefficients a, b; got values for a"):
        LearnedForce("axis", "a*q + b", a=1.0)


def test_a_law_survives_yaml():
    law = LearnedForce("axis", "-a*v + c*hysteresis(b)", a=0.1, b=0.2, c=-3.0)
    assert effect_from_dict(law.to_dict()) == law


def swing(domain, seconds=1.0):
    """The angle at the end, and every angle before."""
    model = domain.compile()
    data = mujoco.MjData(model)
    data.qpos[0], data.ctrl[0] = 0.8, 0.3
    angles = []
    for _ in range(round(seconds / model.opt.timestep)):
        advance(model, data)
        angles.append(data.qpos[0])
    return np.array(angles)


def domain(*effects):
    return Domain("d", lambda: mujoco.MjSpec.from_string(PENDULUM), tuple(effects))


def test_a_domain_feels_a_law_as_it_feels_the_same_in_mjcf():
    damped = effect_from_dict({"effect": "joint_damping", "target": "axis", "parameters": {"damping": 0.3}})
    np.testing.assert_allclose(swing(domain(LearnedForce("axis", "-a*v", a=0.3))), swing(domain(damped)), atol=2e-3)
    assert np.abs(swing(domain(damped)) - swing(domain())).max() > 0.05


def test_load_and_motor_are_what_mujoco_says():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    acting = ActingForces(model, [LearnedForce("axis", "motor - load")])
    now = MotionNow(np.array([[0.5]]), np.zeros((1, 1)), np.array([[0.3]]), np.zeros((1, 0)), np.zeros(1))
    weight = 9.81 * 0.2 * np.sin(0.5)
    assert acting.forces(acting.signals(now), np.zeros((1, 0)))[0, 0] == pytest.approx(0.6 - weight, abs=1e-6)


def test_a_simulation_forgets_when_it_is_reset_and_keeps_forces_that_others_applied():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    register_laws(model, [LearnedForce("axis", "-a*hysteresis(0.1)", a=5.0)])
    data = mujoco.MjData(model)

    def play():
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.qfrc_applied[0] = 0.5, 0.25
        advance(model, data, 300)
        return data.qpos[0]

    first = play()
    assert first == play() and data.qfrc_applied[0] == 0.25


def test_a_network_has_as_many_weights_as_it_needs_and_stays_in_its_spans():
    spans, weights = (1.0, 2.0), (1.0, 0.0, 0.0, 1.0, 0.1, -0.1, 0.5, 0.5, 0.2)  # two inputs, two hidden units
    box = ResidualNetwork("axis", "q v", spans, weights, 3.0)
    inside = box.force_from({"q": np.array([0.5]), "v": np.array([1.0])}, np.zeros((1, 0)))
    assert inside[0] == pytest.approx(3 * (0.5 * np.tanh(0.6) + 0.5 * np.tanh(0.4) + 0.2))
    far = [box.force_from({"q": np.array([x]), "v": np.array([9.0])}, np.zeros((1, 0)))[0] for x in (1.0, 50.0)]
    assert far[0] == far[1]
    with pytest.raises(ValueError, match="fit no network"):
        ResidualNetwork("axis", "q v", spans, weights[:-1], 3.0)


def test_a_law_of_commands_needs_an_actuator_on_its_joint():
    idle = PENDULUM.replace('<motor name="axis" joint="axis" gear="2"/>', "")
    with pytest.raises(ValueError, match="depends on u, but no actuator acts on joint 'axis'"):
        LearnedForce("axis", "a*u", a=1.0).apply(mujoco.MjSpec.from_string(idle))
    with pytest.raises(ValueError, match="depends on motor, but no actuator acts on joint 'axis'"):
        LearnedForce("axis", "a*motor*v", a=1.0).apply(mujoco.MjSpec.from_string(idle))
    tendon = '<tendon><fixed name="t"><joint joint="axis" coef="1"/></fixed></tendon><actuator>'
    by_tendon = PENDULUM.replace("<actuator>", tendon).replace('joint="axis" gear', 'tendon="t" gear')
    LearnedForce("axis", "a*motor*v", a=1.0).apply(mujoco.MjSpec.from_string(by_tendon))
    with pytest.raises(ValueError, match="the model has no joint named 'knee'; it has: axis"):
        LearnedForce("knee", "a*v", a=1.0).apply(mujoco.MjSpec.from_string(PENDULUM))


@pytest.mark.parametrize("kind", ["free", "ball"])
@pytest.mark.parametrize("target", ["axis", "*"])
def test_a_law_needs_a_joint_with_one_angle(kind, target):
    other = mujoco.MjSpec.from_string(PENDULUM.replace('axis="0 1 0"', f'type="{kind}"'))
    with pytest.raises(ValueError, match="a law needs a hinge or a slide, not a free or ball joint"):
        LearnedForce(target, "a*v", a=1.0).apply(other)
