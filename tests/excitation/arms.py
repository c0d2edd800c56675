"""A servo arm, a hanging pendulum, and reports that leave explanations open, for the tests of motions."""

import json

import mujoco
import numpy as np

from idapt_pl.diagnosis.answer.explanation import ExplainingEffect, Explanation, Measurement, Standing
from idapt_pl.effects.actuators import ActuatorBias
from idapt_pl.effects.bodies import BodyCom
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.effects.world import ExternalForce
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.limits import limits_of
from idapt_pl.excitation.plan import MotionPlan
from idapt_pl.excitation.rivals import LeftOpen, rival_of

SERVO = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom name="wall" type="box" size="0.02 0.5 0.5" pos="0.3 0 0.5"/>
    <body name="arm" pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" range="-2 2" limited="true" damping="0.2"
             frictionloss="0.02" armature="0.01"/>
      <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 0.4" mass="0.4"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="shoulder" kp="20" kv="0.5" ctrlrange="-1.5 1.5" ctrllimited="true"/>
  </actuator>
</mujoco>"""
"""A rod on a servo that stands up; a wall beside it is reached at about 0.75 rad."""

RAIL = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="2" stiffness="8" range="-1 1" limited="true"/>
      <geom size="0.1" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail" gear="10" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>"""
"""A cart: an offset of its commands is a constant force, whatever it does."""

NOISE = Measurement(0.02, 5, True, (1e-3, 1e-2), (1e-3, 1e-2))


def explained(standing, effect, **free):
    """An explanation with a single effect; ``free`` are nominal value and scale of its parameters."""
    instead = "" if standing is Standing.FOUND else f"{effect.name}({effect.target})"
    return Explanation(standing, instead, (ExplainingEffect(effect, free),), 1.0, 0.5)


DAMPING = explained(Standing.FOUND, JointDamping("shoulder", 0.6), damping=(0.2, 0.2))
FRICTION = explained(Standing.EQUIVALENT, JointFrictionloss("shoulder", 0.12), frictionloss=(0.02, 0.1))
ARMATURE = explained(Standing.RUNNER_UP, JointArmature("shoulder", 0.03), armature=(0.01, 0.02))
OFFSET = explained(Standing.FOUND, ActuatorBias("push", 0.05), bias=(0.0, 0.05))
CENTRE = explained(Standing.FOUND, BodyCom("arm", 0.0, 0.01, 0.02), y=(0.0, 0.1), z=(0.0, 0.1))
"""Along its axis, y, no swing shows where the rod's mass is."""
FORCE = explained(Standing.EQUIVALENT, ExternalForce("cart", 0.5, 0.0, 0.0), x=(0.0, 0.5))


def left_open(*explanations, xml=SERVO, measurement=NOISE):
    rivals = tuple(rival_of((), Explanation.from_dict(json.loads(json.dumps(e.to_dict())))) for e in explanations)
    return LeftOpen(mujoco.MjSpec.from_string(xml), rivals, measurement, {})


def compiled(xml=SERVO):
    return mujoco.MjModel.from_xml_string(xml)


def quick_plan(xml=SERVO, limits=None, **settings):
    return MotionPlan(limits or limits_of(compiled(xml)), **{"duration": 3.0, "seconds": 1.0} | settings)


def forecaster(*explanations, xml=SERVO):
    open_ones = left_open(*explanations, xml=xml)
    model = compiled(xml)
    return MotionForecaster(open_ones.spec, open_ones.rivals, np.zeros(model.nq), np.zeros(model.nu), 0.02, True, 1)


def report_folder(folder, *explanations, xml=SERVO, **changed):
    """A folder as `idapt diagnose` leaves it, and the model: nominal.xml beside it."""
    (folder / "diagnosis").mkdir()
    (folder / "nominal.xml").write_text(xml)
    (folder / "diagnosis" / "unrepaired.xml").write_text(xml)
    effects = [
        {"effect": p.effect.name, "target": p.effect.target, "equivalent": [],
         "parameters": {n: {"nominal": p.free[n][0], "estimate": v, "ci95": [0.9 * v, 1.1 * v], "unit": ""}
                        for n, v in p.effect.to_dict()["parameters"].items() if n in p.free}}
        for e in explanations[:1] for p in e.effects
    ]  # fmt: skip
    report = {
        "schema": "idapt.diagnosis/1", "verdict": "effects_found" if explanations else "no_missing_effect",
        "effects": effects, "declared": [], "explanations": [e.to_dict() for e in explanations],
        "measurement": NOISE.to_dict(),
    } | changed  # fmt: skip
    (folder / "diagnosis" / "report.json").write_text(json.dumps(report))
    return folder
