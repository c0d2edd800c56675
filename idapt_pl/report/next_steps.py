"""What to do about each effect: how to confirm it on the machine, and where it comes from."""

from __future__ import annotations

from collections.abc import Sequence

from idapt_pl.diagnosis.answer.result import EffectEstimate
from idapt_pl.effects.wording import phrase_at
from idapt_pl.report.html import Markup, link, paragraph, row, section, table

CONFIRM = {
    "body_mass": "Weigh the part with all that is mounted on it. Or hold several poses and read the torques.",
    "body_inertia": "Weigh the part and balance it on an edge. Then swing it fast, with the other joints still.",
    "body_com": "Balance the part on an edge; or hold poses in which it points up, sideways and down.",
    "payload": "Is something mounted that the model lacks? Record once without it.",
    "joint_damping": "Turn the joint at several constant speeds both ways: the torque should grow with the speed.",
    "joint_frictionloss": "Turn the joint slowly, both ways: it is half the difference of the torques.",
    "joint_stribeck": "Start from rest very slowly, several times, and go through several slow speeds.",
    "joint_armature": "Reverse the joint fast at small amplitude; look for rotor inertia times gear ratio squared.",
    "joint_stiffness": "Hold several poses with the motor off: does a cable or a spring pull back?",
    "joint_springref": "Hold several poses with the motor off, and note where the joint rests.",
    "joint_drag": "Run at the highest speeds allowed, both ways.",
    "joint_range": "Move the joint by hand against its end and read the encoder; look for a cable that tightens first.",
    "joint_backlash": "Hold the motor and move the link by hand; then reverse slowly under load.",
    "shared_motor": "Turn the first joint alone, and watch the second one's motor: does it turn, or need a torque?",
    "joint_cogging": "Turn slowly through whole turns and look for a ripple that repeats with the angle.",
    "actuator_gain": "Hold a known weight on a lever and compare torque and command; check supply and current limit.",
    "motor_constant": "Measure voltage over speed with the motor turned by hand or another motor.",
    "motor_resistance": "Measure between two terminals of the motor, cold and warm; add driver, cables and supply.",
    "motor_strength": "Push the held joint with a known force; measure the supply under load.",
    "actuator_kp": "Read the gains from the drive; push the held joint with a known force and note how far it gives.",
    "actuator_kv": "Read the gains from the drive; give steps of several sizes.",
    "actuator_bias": "Send zero and watch; calibrate the zero of drive and encoder.",
    "actuator_curve": "Command a staircase from nothing to full against a scale, and plot force over command.",
    "actuator_deadzone": "Ramp the command up from zero, both ways, and note where motion begins.",
    "actuator_saturation": "Ramp the command up against a stop; read the current limit of the drive.",
    "actuator_rotation": "Command one axis at a time and note which one moves.",
    "actuator_delay": "Send single steps and note when motion begins; look at bus and filter settings.",
    "actuator_lag": "Send steps of several sizes; look for filters or ramps in the drive.",
    "sensor_bias": "Move the joint to a mechanical reference and read the encoder.",
    "sensor_gain": "Turn the joint by a known angle and compare; check gear ratio and counts per turn.",
    "sensor_delay": "Tap the joint with a second sensor on it; compare time stamps.",
    "contact_friction": "Drag the foot or gripper with a scale; record slips at several loads.",
    "contact_softness": "Press with known loads and note how deep; record drops from several heights.",
    "fluid_drag": "Record fast motion with the largest surfaces ahead, both ways.",
    "gravity_direction": "Put a level on the base; record with the base turned by a known angle.",
    "external_force": "Look for cables, fans, springs or a hand; record with the arm turned the other way.",
    "learned_force": "Vary what the formula depends on, one at a time, and hold the rest: does the force follow it?",
    "residual_network": "It says where, not what: record that joint alone, at several speeds, loads and temperatures.",
    "numerics": "Nothing to measure: take over time step and integrator, or a still finer step.",
    "camera_pose": "Measure where the camera stands and where it looks.",
    "camera_frame": "Show a chessboard and calibrate the lens.",
    "light": "Photograph a white sheet where the robot stands, with the lights as they are in use.",
    "color": "Photograph the part beside a colour chart.",
    "material": "Photograph the part under a lamp from several sides: do highlights move?",
    "texture": "Photograph the surface from straight above, evenly lit.",
    "scenery": "Photograph the scene without the robot, and list what stands there.",
    "renderer": "Nothing to measure: take over the renderer's settings.",
    "blur": "Photograph a printed edge at rest and in motion; look at focus and exposure time.",
}
"""By effect, how to confirm it on the machine."""

OTHERWISE = "Record larger and more varied motion of what it acts on, at several speeds and loads."


def anchor_of(effect: EffectEstimate) -> str:
    """The place on the page that says what to do about an effect."""
    return "next-" + "".join(c if c.isalnum() else "_" for c in f"{effect.effect}-{effect.target}")


def linked_name(effect: EffectEstimate) -> Markup:
    """An effect in words, as a link to what to do about it."""
    return link(phrase_at(*effect.key), anchor_of(effect))


def next_steps_section(effects: Sequence[EffectEstimate], next_experiment: str) -> str:
    """What to record or do next, effect by effect; empty where there is nothing to do."""
    text = next_experiment[:1].upper() + next_experiment[1:]
    rows = [next_row(e) for e in effects]
    if not rows:
        return section("What to record next", paragraph(text)) if text else ""
    told = table(("effect", "to confirm it on the machine"), rows)
    return section("What to do next", paragraph(text) if text else "", told)


def next_row(effect: EffectEstimate) -> str:
    """One effect: how to confirm it, and how to tell it from what it could also be."""
    words = CONFIRM.get(effect.effect, OTHERWISE)
    others = list(dict.fromkeys(a.effect for a in effect.equivalent if a.effect != effect.effect))[:2]
    for other in others:
        if other in CONFIRM:
            words += f" Against {phrase_at(other, '*')}: {CONFIRM[other]}"
    named = Markup(f'<span id="{anchor_of(effect)}"></span>')
    return row(named + Markup.of(phrase_at(*effect.key)), words)
