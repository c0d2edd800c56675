"""Contacts, heights and forces are those of the model that moves: with its filters, its errors, and a tenth off."""

import mujoco
import numpy as np
import pytest
from arms import OFFSET, RAIL, SERVO, compiled, explained, forecaster, left_open, quick_plan

from idapt_pl.diagnosis.answer.explanation import Standing
from idapt_pl.effects.actuators import ActuatorBias
from idapt_pl.effects.joints import JointBacklash, JointDamping
from idapt_pl.effects.signals import ActuatorLag
from idapt_pl.excitation.limits import limits_of
from idapt_pl.excitation.plan import prepare_search
from idapt_pl.excitation.safety import PoseCheck
from idapt_pl.excitation.variants import varied

FILTER = 'ctrlrange="-5 5" ctrllimited="true" dyntype="filterexact" dynprm="0.05"/>'
FILTERED = RAIL.replace('<motor name="push" joint="rail" gear="10" ctrlrange="-1 1" ctrllimited="true"/>',
                        f'<general name="push" joint="rail" {FILTER}')  # fmt: skip
HANGING = SERVO.replace('kv="0.5"', 'kv="0.5" timeconst="0.05"')
"""A servo with a filter in front."""
TWO = RAIL.replace("</actuator>", f'<general name="late" joint="rail" {FILTER}</actuator>')
HEAVY = explained(Standing.FOUND, JointDamping("rail", 3.0), damping=(2.0, 1.0))
TURNED = explained(Standing.FOUND, JointDamping("shoulder", 0.6), damping=(0.2, 0.2))


def forces(xml, commands, explanation=HEAVY, start=None, limit=2.0):
    """Margins of the actuators' forces by the first explanation."""
    foretold = forecaster(explanation, xml=xml)
    effects = foretold.rivals[0].effects
    seen = foretold(effects, np.array(commands, float)[None], start)
    check = PoseCheck(foretold.sim.compile(effects), limits_of(compiled(xml), force={"*": (0, limit)}))
    return {m.what: m for m in check.forbidden(seen.states[0], seen.arriving[0]) if m.what.startswith("force")}


def test_a_filtered_motor_exerts_what_its_filter_lets_through():
    steps = np.concatenate([np.zeros((10, 1)), np.full((50, 1), 4.5)])
    (late,) = forces(FILTERED, steps).values()
    assert late.reached == pytest.approx(4.5, abs=0.01) and late.room == pytest.approx(-2.5 / 4, abs=0.01)
    (soon,) = forces(FILTERED, steps[:12]).values()
    # 0.04 s after the step, less the time step that ends there: its force follows from the filter's state before it
    seconds = 0.04 - compiled(FILTERED).opt.timestep
    assert soon.reached == pytest.approx(4.5 * (1 - np.exp(-seconds / 0.05)), rel=1e-3) and soon.room < 0.05


def test_a_filtered_servo_that_holds_its_place_exerts_next_to_nothing():
    (held,) = forces(HANGING, np.full((20, 1), 0.3), TURNED, np.array([0.3])).values()
    assert abs(held.reached) < 0.5  # what the rod weighs there


def test_a_filter_beside_a_motor_begins_with_its_command_too():
    margins = forces(TWO, np.tile([0.1, 1.5], (3, 1)))
    assert margins["force push"].reached == pytest.approx(0.1) and margins["force late"].reached == pytest.approx(1.5)


def test_errors_of_commands_count_in_the_force():
    biased = explained(Standing.FOUND, ActuatorBias("push", 0.4), bias=(0.0, 0.05))
    lagging = explained(Standing.FOUND, ActuatorLag("push", 0.2), time_constant=(0.0, 0.02))
    steps = np.concatenate([np.zeros((5, 1)), np.full((5, 1), 0.5)])
    assert forces(RAIL, steps, OFFSET)["force push"].reached == pytest.approx(0.55)
    assert forces(RAIL, steps, biased, limit=0.8)["force push"].room == pytest.approx(-0.1 / 1.6)
    assert forces(RAIL, steps, lagging)["force push"].reached == pytest.approx(0.5 * (1 - np.exp(-0.5)), rel=0.05)


def test_forces_are_checked_with_motors_that_are_a_tenth_stronger():
    limits = limits_of(compiled(RAIL), force={"*": (0, 0.5)})
    search, _, _ = prepare_search(left_open(HEAVY, xml=RAIL), quick_plan(RAIL, limits), threads=1)
    commands = np.full((1, 60, 1), 0.49)
    forecast = search.criterion.forecast
    plain = {m.what: m for m in search.margins_of([forecast(forecast.rivals[0].effects, commands)])}
    varied = {m.what: m for m in search.margins_with_variants(commands)}
    assert plain["force push"].reached == pytest.approx(0.49) and plain["force push"].room > 0
    assert 0.5 < varied["force push"].reached <= 0.49 * 1.1 and varied["force push"].room < 0


def test_a_model_with_play_is_looked_at_as_it_is():
    loose = explained(Standing.FOUND, JointBacklash("shoulder", 0.1), width=(0.0, 0.05))
    assert abs(forces(SERVO, np.zeros((5, 1)), loose)["force servo"].reached) < 0.1


def at(model, *poses):
    """States at rest in these poses, (n, size)."""
    data, states = mujoco.MjData(model), []
    for pose in poses:
        data.qpos[:] = pose
        states.append(np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
        mujoco.mj_getState(model, data, states[-1], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return np.array(states)


def test_contacts_heights_and_forces_are_seen():
    model = compiled()
    check = PoseCheck(model, limits_of(model, force={"*": (0, 5.0)}, lowest=0.8))
    still = {m.what: m for m in check.forbidden(at(model, 0.0, 0.0), np.zeros((2, 1)))}
    assert still["contacts"].room == 0 and still["force servo"].room == pytest.approx(0.5)
    assert still["height"].reached == pytest.approx(0.48)  # the rod's lower end, with its radius
    hit = {m.what: m for m in check.forbidden(at(model, 0.0, 0.8), np.array([[0.0], [1.0]]))}
    assert hit["contact of wall and rod"].room == -1 and hit["force servo"].reached == pytest.approx(4.0)


def test_what_touches_at_the_start_may_touch_on():
    model = compiled()
    assert PoseCheck(model, limits_of(model)).forbidden(at(model, 0.8, 0.85), np.zeros((2, 1)))[0].room == 0


def test_more_friction_than_an_explicit_integrator_bears_does_not_blow_a_variant_up():
    """RK4 bears a rate of damping of 2.78 a time step: here that of the model is 2.6, and some variants have more."""
    explicit = RAIL.replace('timestep="0.005" integrator="implicitfast"', 'timestep="0.01" integrator="RK4"')
    damped = explained(Standing.FOUND, JointDamping("rail", 260.0), damping=(2.0, 1.0))  # the cart has 1 kg
    foretold = forecaster(damped, xml=explicit)
    effects, rng = foretold.rivals[0].effects, np.random.default_rng(0)
    model, commands = foretold.sim.compile(effects), np.full((1, 50, 1), 0.5)
    still = foretold(effects, 0 * commands)
    for _ in range(8):
        variant = varied(model, effects, rng)
        seen = foretold(variant, commands, still.qpos[0, 0])
        assert np.abs(seen.qvel).max() < 1, foretold.sim.compile(variant).dof_damping
