"""Drives in the terms of an actuator config, against what MuJoCo's own drives do."""

from types import SimpleNamespace

import mujoco
import pytest

from idapt_pl.diagnosis.answer.result import EffectEstimate, ParameterEstimate
from idapt_pl.effects.actuators import ActuatorKp, ActuatorSaturation
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag, SensorDelay
from idapt_pl.report.actuator_settings import drive_settings

ARM = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body>
<joint name="hinge" axis="0 1 0" damping="0.3" armature="0.02" frictionloss="0.1" {joint}/>
<geom size="0.1" mass="1" pos="0 0 0.3" contype="0" conaffinity="0"/></body></worldbody>
<actuator>{drive}</actuator></mujoco>"""


def settings(drive, *effects, joint="", found=()):
    """The settings of one joint, and what they leave out, of a diagnosis that found these effects."""
    spec = mujoco.MjSpec.from_string(ARM.format(drive=drive, joint=joint))
    result = SimpleNamespace(effects=found)
    diagnosis = SimpleNamespace(sim=SimpleNamespace(spec=spec), effects=effects, declared=(), result=result)
    (made,), unsaid = drive_settings(diagnosis)
    return made, " ".join(unsaid)


def torque(drive, q, v, command):
    """What acts on the joint but for dry friction, N·m."""
    model = mujoco.MjModel.from_xml_string(ARM.format(drive=drive, joint=""))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, command
    mujoco.mj_forward(model, data)
    return float(data.qfrc_actuator[0] + data.qfrc_passive[0])


@pytest.mark.parametrize("gear", [1, 3, -0.5])
def test_a_servo_behind_a_gear_pulls_as_its_stiffness_and_damping_say(gear):
    drive = f'<position name="m" joint="hinge" kp="7" kv="0.4" gear="{gear}"/>'
    made, _ = settings(drive)
    assert made.servo and made.values["stiffness"] == pytest.approx(7 * gear**2)
    assert made.values["damping"] == pytest.approx(0.3 + 0.4 * gear**2)
    target, q, v = 0.2, -0.3, 1.5
    expected = made.values["stiffness"] * (target - q) - made.values["damping"] * v
    assert torque(drive, q, v, gear * target) == pytest.approx(expected)


def test_a_motor_has_no_stiffness_and_its_limit_is_behind_the_gear():
    made, _ = settings('<motor name="m" joint="hinge" gear="-50" ctrlrange="-0.2 0.1"/>')
    assert not made.servo and made.values["stiffness"] == 0 and made.values["damping"] == pytest.approx(0.3)
    assert made.values["effort_limit"] == pytest.approx(10.0)
    assert (made.values["armature"], made.values["friction"]) == pytest.approx((0.02, 0.1))
    assert "delay" not in made.values and not made.intervals


@pytest.mark.parametrize(
    ("drive", "joint", "limit"),
    [
        ('<position name="m" joint="hinge" kp="7" gear="3" forcerange="-2 2"/>', "", 6.0),
        ('<position name="m" joint="hinge" kp="7" gear="3" forcerange="-2 2"/>', 'actuatorfrcrange="-4 4"', 4.0),
        ('<position name="m" joint="hinge" kp="7" ctrlrange="-1 1"/>', 'actuatorfrcrange="-4 4"', 4.0),
        ('<motor name="m" joint="hinge" gear="3" ctrlrange="-1 1" forcerange="-5 5"/>', "", 3.0),
        ('<position name="m" joint="hinge" kp="7" ctrlrange="-1 1"/>', "", None),
    ],
)
def test_the_effort_limit_is_the_tightest_of_those_that_there_are(drive, joint, limit):
    made, unsaid = settings(drive, joint=joint)
    assert made.values.get("effort_limit") == (None if limit is None else pytest.approx(limit))
    assert ("effort limits of drives that have none" in unsaid) == (limit is None)


def test_delays_of_the_model_of_commands_and_of_sensors_add_up():
    own = '<motor name="m" joint="hinge" delay="0.01" nsample="6"/>'
    assert settings(own)[0].values["delay"] == pytest.approx(0.01)
    made, unsaid = settings(own, ActuatorDelay("*", 0.02), SensorDelay("*", 0.005))
    assert made.values["delay"] == pytest.approx(0.035) and "sensor_delay on *: counted as a delay" in unsaid


def test_what_was_found_is_in_the_terms_with_its_interval():
    drive = '<position name="m" joint="hinge" kp="10" kv="0" gear="2"/>'
    effects = (ActuatorKp("m", 1.5), JointDamping("hinge", 0.5), ActuatorSaturation("m", force=3.0))
    found = [EffectEstimate("actuator_kp", "m", {"factor": ParameterEstimate(1.0, 1.5, (1.4, 1.7), "1")})]
    made, unsaid = settings(drive, *effects, found=found)
    assert made.values["stiffness"] == pytest.approx(60.0) and made.intervals["stiffness"] == pytest.approx((56, 68))
    assert made.values["damping"] == pytest.approx(0.5) and made.values["effort_limit"] == pytest.approx(6.0)
    assert set(made.intervals) == {"stiffness"} and "no term for it" not in unsaid


@pytest.mark.parametrize(
    ("drive", "effects", "words"),
    [
        ('<motor name="m" joint="hinge"/>', (ActuatorLag("m", 0.03),), "lag on m: a first-order filter of 0.03 s"),
        (
            '<general name="m" joint="hinge" dyntype="filterexact" dynprm="0.04"/>',
            (),
            "m: a first-order filter of 0.04",
        ),
        ('<dcmotor name="m" joint="hinge" motorconst="0.05" resistance="2" input="voltage"/>', (), "m: a drive of"),
    ],
    ids=["lag", "own filter", "DC motor"],
)
def test_what_the_terms_cannot_say_is_said_in_words(drive, effects, words):
    assert words in settings(drive, *effects)[1]
