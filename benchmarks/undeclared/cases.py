"""The cases: what is hidden in which model, how it is recorded, and which answers are right."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.undeclared import hidden
from benchmarks.undeclared.hidden import Part, Truth
from benchmarks.undeclared.models import MODELS, Noise

Answer = frozenset[tuple[str, str]]  # effects found, each (effect, target)


@dataclass(frozen=True)
class Numerics:
    """How the true world is integrated: the nominal time step divided, and an integrator (None: the nominal one)."""

    divide: int = 1
    integrator: str | None = None


SAME = Numerics()
FINE = Numerics(5, "implicitfast")
RK4 = Numerics(1, "RK4")


@dataclass(frozen=True)
class Case:
    """One entry of the benchmark.

    Attributes:
        name: of the case.
        model: key of ``models.MODELS``.
        truth: the hidden effects; empty for a control.
        kind: ``single``, ``double`` (two or more at once), ``outside`` (of the library), ``confounded``
            (several effects fit equally well) or ``control`` (nothing is hidden).
        accept: the right answers, each a set of (effect, target). A class that is reported is right if its members
            are among the accepted ones. Empty for ``outside``, where the verdict should be ``unexplained_residual``.
            ``("numerics", "world")`` may be added to any answer where :attr:`other_numerics` is true.
        parts: how the truth is made.
        numerics: of the true world.
        noise: of the sensors.
        amplitude: factor on the model's command amplitude.
        still: episodes start at rest in the middle of the start range.
        may_abstain: ``insufficient_excitation`` is right as well.
    """

    name: str
    model: str
    truth: tuple[Truth, ...]
    kind: str
    accept: tuple[Answer, ...]
    parts: tuple[Part, ...]
    numerics: Numerics
    noise: Noise
    amplitude: float = 1.0
    still: bool = False
    may_abstain: bool = False

    @property
    def other_numerics(self) -> bool:
        """Whether the true world is integrated otherwise than the nominal model."""
        return self.numerics != SAME


CASES: dict[str, Case] = {}


def _add(
    name: str,
    model: str,
    *parts: Part,
    kind: str | None = None,
    also: tuple[set[tuple[str, str]], ...] = (),
    numerics: Numerics = FINE,
    noise: Noise | None = None,
    **settings: float | bool,
) -> None:
    """Register a case; the truth itself is the first accepted answer, ``also`` are the others."""
    assert name not in CASES, name
    truth = tuple(part.truth for part in parts)
    kind = kind or ("control", "single", "double")[min(len(parts), 2)]
    answers = [frozenset((t.effect, t.target) for t in truth), *map(frozenset, also)]
    accept = () if kind == "outside" else tuple(answers)
    noise = noise or MODELS[model].noise
    CASES[name] = Case(name, model, truth, kind, accept, parts, numerics, noise, **settings)


# --- inverted pendulum: one actuator, unstable, short episodes -------------------------------------------

PENDULUM = "inverted_pendulum"
SLIDE_FORCE = ({("actuator_bias", "slide")}, {("actuator_bias", "*")}, {("external_force", "cart")})
ONE_DELAY = ({("actuator_delay", "slide")}, {("sensor_delay", "*")}, {("sensor_delay", "world")})

_add("pendulum_slider_damping", PENDULUM, hidden.joint_damping("slider", 5.0))
_add("pendulum_hinge_damping", PENDULUM, hidden.joint_damping("hinge", 1.5), numerics=SAME)
_add("pendulum_gain", PENDULUM, hidden.motor_gain("slide", 0.85), also=({("actuator_gain", "*")},))
_add("pendulum_pole_mass", PENDULUM, hidden.body_mass("pole", 7.0), numerics=SAME)
_add(
    "pendulum_pole_com",
    PENDULUM,
    hidden.body_com("pole", (0.0, 0.0, 0.06)),
    also=({("body_inertia", "pole")},),
)
_add("pendulum_tilt", PENDULUM, hidden.tilt(tilt_y=0.035))
_add("pendulum_frictionloss", PENDULUM, hidden.joint_frictionloss("slider", 10.0))
_add("pendulum_delay", PENDULUM, hidden.command_delay(0.04), also=ONE_DELAY, numerics=SAME)
_add("pendulum_lag", PENDULUM, hidden.command_lag("slide", 0.04), also=({("actuator_lag", "*")},))
_add("pendulum_slide_bias", PENDULUM, hidden.command_bias("slide", 0.12), kind="confounded", also=SLIDE_FORCE)
_add(
    "pendulum_cart_force",
    PENDULUM,
    hidden.external_force("cart", (-12.0, 0.0, 0.0)),
    kind="confounded",
    also=SLIDE_FORCE,
    numerics=SAME,
)
_add(
    "pendulum_mass_and_friction",
    PENDULUM,
    hidden.body_mass("pole", 6.8),
    hidden.joint_frictionloss("slider", 12.0),
)

# --- half cheetah: contacts, springs, a coarse time step -------------------------------------------------

CHEETAH = "half_cheetah"
BTHIGH_SPRING = ({("joint_springref", "bthigh")}, {("actuator_bias", "bthigh")})
ALL_DELAY = ({("sensor_delay", "*")}, {("sensor_delay", "world")})

_add("cheetah_bthigh_gain", CHEETAH, hidden.motor_gain("bthigh", 0.8))
_add("cheetah_weak_battery", CHEETAH, hidden.motor_gain("*", 0.85))
_add("cheetah_fshin_damping", CHEETAH, hidden.joint_damping("fshin", 5.0))
_add("cheetah_bshin_frictionloss", CHEETAH, hidden.joint_frictionloss("bshin", 6.0), numerics=SAME)
_add("cheetah_delay", CHEETAH, hidden.command_delay(0.05), also=ALL_DELAY)
_add("cheetah_half_delay", CHEETAH, hidden.command_delay(0.024), also=ALL_DELAY)
_add("cheetah_slippery_floor", CHEETAH, hidden.contact_friction("*", 0.15))
_add(
    "cheetah_grippy_floor",
    CHEETAH,
    hidden.contact_friction("floor", 0.9),
    also=({("contact_friction", "*")},),
    numerics=SAME,
)
_add(
    "cheetah_soft_contact",
    CHEETAH,
    hidden.contact_softness(0.06),
    also=({("contact_softness", "floor")},),
)
_add(
    "cheetah_payload",
    CHEETAH,
    hidden.payload("torso", 2.0, (-0.3, 0.0, 0.08)),
    also=({("body_inertia", "torso")},),
)
_add("cheetah_torso_mass", CHEETAH, hidden.body_mass("torso", 8.0), numerics=SAME)
_add("cheetah_tilt", CHEETAH, hidden.tilt(tilt_y=0.07))
_add("cheetah_ffoot_stiffness", CHEETAH, hidden.joint_stiffness("ffoot", 30.0))
_add("cheetah_fthigh_armature", CHEETAH, hidden.joint_armature("fthigh", 0.35))
_add("cheetah_fthigh_saturation", CHEETAH, hidden.command_limit("fthigh", 0.45))
_add("cheetah_bthigh_deadzone", CHEETAH, hidden.deadzone("bthigh", 0.2), numerics=SAME)
_add("cheetah_lag", CHEETAH, hidden.command_lag("*", 0.03))
_add("cheetah_towed", CHEETAH, hidden.external_force("torso", (-15.0, 0.0, 0.0)))
_add("cheetah_bthigh_springref", CHEETAH, hidden.joint_springref("bthigh", 0.06), kind="confounded", also=BTHIGH_SPRING)
_add("cheetah_bthigh_bias", CHEETAH, hidden.command_bias("bthigh", -0.1), kind="confounded", also=BTHIGH_SPRING)
_add(
    "cheetah_spring_and_gain",
    CHEETAH,
    hidden.joint_stiffness("bthigh", 160.0),
    hidden.motor_gain("fthigh", 1.33),
)
_add(
    "cheetah_delay_and_slippery",
    CHEETAH,
    hidden.command_delay(0.05),
    hidden.contact_friction("*", 0.15),
    also=tuple({e, ("contact_friction", "*")} for (e,) in ALL_DELAY),
    numerics=SAME,
)
_add("cheetah_dead_motor", CHEETAH, hidden.dropout("bfoot", 2.5), kind="outside")

# --- walker: hidden play, limbs that fall, 8 ms control --------------------------------------------------

WALKER = "walker2d"

_add("walker_leg_gain", WALKER, hidden.motor_gain("leg_joint", 0.75))
_add("walker_left_armature", WALKER, hidden.joint_armature("thigh_left_joint", 0.1))
_add("walker_thigh_left_damping", WALKER, hidden.joint_damping("thigh_left_joint", 1.0), numerics=SAME)
_add("walker_leg_left_frictionloss", WALKER, hidden.joint_frictionloss("leg_left_joint", 5.0))
_add("walker_leg_mass", WALKER, hidden.body_mass("leg", 4.2))
_add("walker_slippery_feet", WALKER, hidden.contact_friction("*", 0.3))
_add("walker_viscous_air", WALKER, hidden.fluid("viscosity", 1.5))
_add("walker_lag", WALKER, hidden.command_lag("*", 0.03))
_add("walker_foot_backlash", WALKER, hidden.backlash("foot_joint", 0.04))
_add("walker_thigh_encoder", WALKER, hidden.sensor_bias("thigh_joint", 0.06))
_add(
    "walker_three",
    WALKER,
    hidden.command_delay(0.024),
    hidden.motor_gain("thigh_left_joint", 0.75),
    hidden.joint_damping("leg_joint", 3.0),
    also=tuple({e, ("actuator_gain", "thigh_left_joint"), ("joint_damping", "leg_joint")} for (e,) in ALL_DELAY),
)
_add("walker_shaken", WALKER, hidden.periodic_push("torso", (60.0, 0.0, 0.0), 3.0), kind="outside")
_add("walker_longer_foot", WALKER, hidden.foot_length("foot_geom", "foot", 1.25), kind="outside")

# --- reacher: rotor inertia dominates, two coordinates that never move -----------------------------------

REACHER = "reacher"

_add("reacher_joint0_gain", REACHER, hidden.motor_gain("joint0", 0.85))
_add("reacher_joint1_damping", REACHER, hidden.joint_damping("joint1", 2.0), numerics=SAME)
_add("reacher_joint1_frictionloss", REACHER, hidden.joint_frictionloss("joint1", 2.0))
_add("reacher_joint0_armature", REACHER, hidden.joint_armature("joint0", 1.3))
_add("reacher_joint0_deadzone", REACHER, hidden.deadzone("joint0", 0.02))
_add("reacher_joint1_cogging", REACHER, hidden.cogging("joint1", 4.0, 6))
_add(
    "reacher_damping_and_gain",
    REACHER,
    hidden.joint_damping("joint0", 1.6),
    hidden.motor_gain("joint1", 0.85),
)

# --- servo arm: position servos, gravity, no contacts ----------------------------------------------------

SERVO = "servo_arm"
YAW_OFFSET = ({("sensor_bias", "yaw")}, {("actuator_bias", "yaw")})
YAW_INERTIA = tuple(
    {one} for one in (("joint_armature", "yaw"), *((e, "turret") for e in ("body_mass", "body_inertia", "payload")))
)
GRIPPED = tuple(
    {(effect, body)}
    for effect, body in (
        ("body_mass", "gripper"),
        ("payload", "gripper"),
        ("payload", "forearm"),
        ("body_inertia", "gripper"),
        ("body_inertia", "forearm"),
    )
)
SERVO_DELAY = ({("actuator_delay", "*")}, *ALL_DELAY)

_add("servo_elbow_frictionloss", SERVO, hidden.joint_frictionloss("elbow", 0.3))
_add("servo_shoulder_damping", SERVO, hidden.joint_damping("shoulder", 0.9), numerics=SAME)
_add("servo_shoulder_cable", SERVO, hidden.joint_stiffness("shoulder", 2.0))
_add(
    "servo_forearm_com",
    SERVO,
    hidden.body_com("forearm", (0.03, 0.0, 0.03)),
    also=({("body_inertia", "forearm")},),
)
_add("servo_base_tilt", SERVO, hidden.tilt(tilt_x=0.12), noise=MODELS[SERVO].noise.times(0.5))
_add("servo_elbow_command_gain", SERVO, hidden.command_gain("elbow", 0.94), numerics=SAME)
_add(
    "servo_shoulder_stiffness",
    SERVO,
    hidden.servo_stiffness("shoulder", 0.75),
    also=({("actuator_kp", "shoulder")}, {("actuator_stiffness", "shoulder")}),
)
_add("servo_weak_elbow", SERVO, hidden.servo_strength("elbow", 0.7))
_add("servo_weak_motors", SERVO, hidden.servo_strength("*", 0.8), numerics=SAME)
_add("servo_shoulder_torque_limit", SERVO, hidden.force_limit("shoulder", 2.0))
_add("servo_lag", SERVO, hidden.command_lag("*", 0.03))
_add("servo_elbow_stribeck", SERVO, hidden.stribeck("elbow", 0.15, 0.6, 0.4))
_add("servo_shoulder_cogging", SERVO, hidden.cogging("shoulder", 0.4, 12))
_add("servo_elbow_backlash", SERVO, hidden.backlash("elbow", 0.025))
_add("servo_elbow_encoder_gain", SERVO, hidden.sensor_gain("elbow", 1.04))
_add("servo_yaw_encoder", SERVO, hidden.sensor_bias("yaw", 0.04), kind="confounded", also=YAW_OFFSET)
_add("servo_yaw_bias", SERVO, hidden.command_bias("yaw", -0.05), kind="confounded", also=YAW_OFFSET, numerics=SAME)
_add("servo_command_delay", SERVO, hidden.command_delay(0.02), kind="confounded", also=SERVO_DELAY)
_add("servo_sensor_delay", SERVO, hidden.sensor_delay(0.012), kind="confounded", also=SERVO_DELAY)
_add("servo_yaw_armature", SERVO, hidden.joint_armature("yaw", 0.04), kind="confounded", also=YAW_INERTIA)
_add("servo_turret_mass", SERVO, hidden.body_mass("turret", 3.2), kind="confounded", also=YAW_INERTIA)
_add(
    "servo_gripper_payload",
    SERVO,
    hidden.payload("gripper", 0.2, (0.0, 0.0, 0.02), radius=0.02),
    kind="confounded",
    also=GRIPPED,
)
_add("servo_gripper_mass", SERVO, hidden.body_mass("gripper", 0.3), kind="confounded", also=GRIPPED, numerics=SAME)
_add(
    "servo_friction_and_tool",
    SERVO,
    hidden.joint_frictionloss("yaw", 0.35),
    hidden.body_mass("gripper", 0.3),
    also=tuple({("joint_frictionloss", "yaw"), *tool} for tool in GRIPPED),
)
_add(
    "servo_lag_and_tilt",
    SERVO,
    hidden.command_lag("*", 0.025),
    hidden.tilt(tilt_x=0.12),
    noise=MODELS[SERVO].noise.times(0.5),
)
_add("servo_warm_motor", SERVO, hidden.servo_fade("shoulder", 0.5, 0.8), kind="outside")
_add("servo_hysteresis", SERVO, hidden.hysteresis("*", 0.05), kind="outside")
_add(
    "servo_bench_shakes",
    SERVO,
    hidden.periodic_push("forearm", (1.2, 0.8, 0.0), 4.0),
    kind="outside",
    numerics=SAME,
)

# --- models that the diagnosis was not developed on ------------------------------------------------------

HOPPER, SWIMMER, DOUBLE, PUSHER = "hopper", "swimmer", "double_pendulum", "pusher"

_add("hopper_thigh_gain", HOPPER, hidden.motor_gain("thigh_joint", 0.75))
_add("hopper_leg_frictionloss", HOPPER, hidden.joint_frictionloss("leg_joint", 8.0), numerics=SAME)
_add("hopper_foot_armature", HOPPER, hidden.joint_armature("foot_joint", 2.0))
_add("hopper_delay", HOPPER, hidden.command_delay(0.016), also=ALL_DELAY)
_add("hopper_slippery", HOPPER, hidden.contact_friction("*", 0.25))
_add("swimmer_thin_fluid", SWIMMER, hidden.fluid("density", 2500.0))
_add("swimmer_rear_motor", SWIMMER, hidden.motor_gain("motor2_rot", 0.7), numerics=SAME)
_add("swimmer_front_damping", SWIMMER, hidden.joint_damping("motor1_rot", 8.0))
_add("double_upper_damping", DOUBLE, hidden.joint_damping("hinge2", 0.4))
_add("double_upper_mass", DOUBLE, hidden.body_mass("pole2", 6.5), numerics=SAME)
_add("double_lag", DOUBLE, hidden.command_lag("slide", 0.03), also=({("actuator_lag", "*")},))
_add("pusher_elbow_damping", PUSHER, hidden.joint_damping("r_elbow_flex_joint", 0.6))
_add("pusher_lift_gain", PUSHER, hidden.motor_gain("r_shoulder_lift_joint", 0.7), numerics=SAME)
_add("pusher_pan_frictionloss", PUSHER, hidden.joint_frictionloss("r_shoulder_pan_joint", 0.4))
_add(
    "pusher_damping_and_delay",
    PUSHER,
    hidden.joint_damping("r_shoulder_lift_joint", 2.5),
    hidden.command_delay(0.05),
    also=tuple({e, ("joint_damping", "r_shoulder_lift_joint")} for (e,) in ALL_DELAY),
)

# --- free bodies that are thrown on a floor: no actuator, impacts ----------------------------------------

CUBE, BALL = "toss_cube", "toss_ball"
OF_ONE = {("contact_friction", "floor")}, {("contact_friction", "cube")}

_add("toss_cube_bounce", CUBE, hidden.contact_law("contact_softness", "damping_ratio", 0.2))
_add("toss_cube_slippery", CUBE, hidden.contact_law("contact_friction", "sliding", 0.2), numerics=SAME)
_add("toss_cube_grippy", CUBE, hidden.contact_law("contact_friction", "sliding", 1.2), also=OF_ONE)
_add("toss_cube_centre", CUBE, hidden.body_com("cube", (0.012, 0.0, -0.006)), also=({("body_inertia", "cube")},))
_add(
    "toss_cube_bounce_and_slippery",
    CUBE,
    hidden.contact_law("contact_softness", "damping_ratio", 0.3),
    hidden.contact_law("contact_friction", "sliding", 0.25),
)
_add("toss_ball_bounce", BALL, hidden.contact_law("contact_softness", "damping_ratio", 0.12), numerics=SAME)
_add("toss_ball_rolling", BALL, hidden.contact_law("contact_friction", "rolling", 0.004))
_add("toss_ball_air", BALL, hidden.fluid("density", 1.2), noise=MODELS[BALL].noise.times(0.4))
_add("control_toss_cube", CUBE)
_add("control_toss_ball", BALL, numerics=SAME)

# --- a hobby servo: a motor with a position loop of its own, against gravity ------------------------------

DESK = "desk_servo"

_add("desk_servo_constant", DESK, hidden.motor("servo", constant=0.7))
_add("desk_servo_resistance", DESK, hidden.motor("servo", resistance=1.6), numerics=SAME)
_add("desk_servo_damping", DESK, hidden.joint_damping("shaft", 0.4))
_add("desk_servo_friction", DESK, hidden.joint_frictionloss("shaft", 0.25))
_add("desk_servo_rotor", DESK, hidden.joint_armature("shaft", 0.04), numerics=SAME)
_add(
    "desk_servo_worn",
    DESK,
    hidden.motor("servo", constant=0.75),
    hidden.joint_frictionloss("shaft", 0.2),
)
_add(
    "desk_servo_other",
    DESK,
    hidden.motor("servo", constant=0.7),
    hidden.motor("servo", resistance=1.5),
    hidden.joint_damping("shaft", 0.2),
    hidden.joint_frictionloss("shaft", 0.18),
)
_add("control_desk_servo", DESK)

# --- held back: written with plausible ranges, and not run before these were settled ----------------------

ROD, DC_ARM, ROTARY = "toss_capsule", "dc_arm", "rotary_pendulum"

_add("toss_capsule_bounce", ROD, hidden.contact_law("contact_softness", "damping_ratio", 0.25))
_add("toss_capsule_slippery", ROD, hidden.contact_law("contact_friction", "sliding", 0.25))
_add("toss_capsule_spin", ROD, hidden.contact_law("contact_friction", "torsional", 0.03), numerics=SAME)
_add("toss_capsule_centre", ROD, hidden.body_com("rod", (0.0, 0.0, 0.02)), also=({("body_inertia", "rod")},))
_add(
    "toss_capsule_bounce_and_slippery",
    ROD,
    hidden.contact_law("contact_softness", "damping_ratio", 0.2),
    hidden.contact_law("contact_friction", "sliding", 0.3),
)
_add("dc_arm_constant", DC_ARM, hidden.motor("hip", constant=0.7))
_add("dc_arm_resistance", DC_ARM, hidden.motor("knee", resistance=1.6))
_add("dc_arm_friction", DC_ARM, hidden.joint_frictionloss("hip", 0.25), numerics=SAME)
_add("dc_arm_constant_and_friction", DC_ARM, hidden.motor("hip", constant=0.7), hidden.joint_frictionloss("knee", 0.15))
_add("rotary_gain", ROTARY, hidden.motor_gain("drive", 0.75), also=({("actuator_gain", "*")},))
_add("rotary_swing_damping", ROTARY, hidden.joint_damping("swing", 0.0004))
_add("rotary_arm_friction", ROTARY, hidden.joint_frictionloss("arm", 0.004))
_add("rotary_cogging", ROTARY, hidden.cogging("arm", 0.004, 7), numerics=SAME)
_add("rotary_delay", ROTARY, hidden.command_delay(0.02), also=({("actuator_delay", "drive")}, {("sensor_delay", "*")}))
_add(
    "rotary_friction_and_mass",
    ROTARY,
    hidden.joint_frictionloss("arm", 0.004),
    hidden.body_mass("pendulum", 0.085),
)
_add("hopper_knee_belt", HOPPER, hidden.shared_motor("thigh_joint", "leg_joint", 5.0, 1.5), numerics=SAME)
_add("pusher_wrist", PUSHER, hidden.shared_motor("r_forearm_roll_joint", "r_wrist_flex_joint", 0.1, 0.1), numerics=SAME)
_add("servo_elbow_belt", SERVO, hidden.shared_motor("shoulder", "elbow", 0.2, 0.1, -1.0), numerics=SAME)
_add("dc_arm_knee_belt", DC_ARM, hidden.shared_motor("hip", "knee", 0.15, 0.05, 0.5))
_add("control_toss_capsule", ROD)
_add("control_dc_arm", DC_ARM)
_add("control_rotary", ROTARY)

# --- end stops: nearer than in the model, or further ----------------------------------------------------------

_add("cheetah_fthigh_stop", CHEETAH, hidden.joint_end("fthigh", "upper", 0.35), numerics=SAME)
_add("servo_shoulder_stop", SERVO, hidden.joint_end("shoulder", "upper", 0.55))
_add("walker_foot_open", WALKER, hidden.joint_end("foot_joint", "lower", -1.4), numerics=SAME)
_add("hopper_thigh_stop", HOPPER, hidden.joint_end("thigh_joint", "lower", -1.6))
_add("hopper_foot_open", HOPPER, hidden.joint_end("foot_joint", "upper", 1.4), numerics=SAME)
_add("pusher_elbow_stop", PUSHER, hidden.joint_end("r_elbow_flex_joint", "lower", -1.6))
_add("double_upper_stop", DOUBLE, hidden.joint_end("hinge2", "lower", -0.65), numerics=SAME)
_add("dc_arm_knee_stop", DC_ARM, hidden.joint_end("knee", "upper", 0.9))
_add(
    "pusher_stop_and_damping",
    PUSHER,
    hidden.joint_end("r_elbow_flex_joint", "lower", -1.6),
    hidden.joint_damping("r_shoulder_lift_joint", 2.5),
)

# --- legged machines: a strike leads to the next --------------------------------------------------------------

ANT, HUMANOID, QUADRUPED = "ant", "humanoid", "quadruped"

_add("ant_torso_mass", ANT, hidden.body_mass("torso", 0.5), numerics=SAME)
_add("ant_hip_damping", ANT, hidden.joint_damping("hip_2", 4.0), numerics=SAME)
_add("ant_ankle_gain", ANT, hidden.motor_gain("ankle_3", 0.75), numerics=SAME)
_add("ant_hip_armature", ANT, hidden.joint_armature("hip_4", 1.6), numerics=SAME)
_add("ant_delay", ANT, hidden.command_delay(0.05), also=ALL_DELAY, numerics=SAME)
_add("humanoid_thigh_mass", HUMANOID, hidden.body_mass("right_thigh", 7.5), numerics=SAME)
_add("humanoid_knee_gain", HUMANOID, hidden.motor_gain("left_knee", 0.7), numerics=SAME)
_add("humanoid_elbow_damping", HUMANOID, hidden.joint_damping("right_elbow", 4.0), numerics=SAME)
_add("quadruped_hip_mass", QUADRUPED, hidden.body_mass("hip_front_left", 7.0), numerics=SAME)
_add("quadruped_knee_damping", QUADRUPED, hidden.joint_damping("knee_back_right", 70.0), numerics=SAME)
_add("quadruped_ankle_friction", QUADRUPED, hidden.joint_frictionloss("ankle_front_right", 12.0), numerics=SAME)
_add("quadruped_delay", QUADRUPED, hidden.command_delay(0.04), also=ALL_DELAY, numerics=SAME)
_add("control_ant", ANT, numerics=SAME)
_add("control_humanoid", HUMANOID, numerics=SAME)
_add("control_quadruped", QUADRUPED, numerics=SAME)
_add("control_ant_fine", ANT)
_add("control_quadruped_fine", QUADRUPED)

# --- a quadrotor, which nothing holds -------------------------------------------------------------------------

ROTORS = "quadrotor"
LIFTED = tuple({one} for one in (("body_inertia", "frame"), ("payload", "frame"), ("actuator_gain", "*")))

_add("quadrotor_mass", ROTORS, hidden.body_mass("frame", 1.15), also=LIFTED, numerics=SAME)
_add("quadrotor_load", ROTORS, hidden.payload("frame", 0.15, (0.05, 0.02, -0.06)), also=({("body_inertia", "frame")},))
_add("quadrotor_com", ROTORS, hidden.body_com("frame", (0.01, -0.006, 0.0)), also=({("body_inertia", "frame")},))
_add("quadrotor_rotor", ROTORS, hidden.motor_gain("back_left", 0.85), numerics=SAME)
_add("quadrotor_lag", ROTORS, hidden.command_lag("*", 0.04))
_add("quadrotor_delay", ROTORS, hidden.command_delay(0.02), also=ALL_DELAY, numerics=SAME)
_add("quadrotor_limit", ROTORS, hidden.command_limit("*", 2.6), numerics=SAME)
_add("quadrotor_curve", ROTORS, hidden.command_curve("*", 0.5, 6.0), amplitude=1.5, numerics=SAME)
_add("quadrotor_pull", ROTORS, hidden.external_force("frame", (0.3, 0.0, 0.0)), numerics=SAME)
_add("quadrotor_rotor_and_lag", ROTORS, hidden.motor_gain("front_left", 0.85), hidden.command_lag("*", 0.04))
_add("control_quadrotor", ROTORS, numerics=SAME)
_add("control_quadrotor_fine", ROTORS)

# --- controls: nothing is hidden -------------------------------------------------------------------------

_add("control_pendulum", PENDULUM, numerics=SAME)
_add("control_cheetah", CHEETAH, numerics=SAME)
_add("control_walker", WALKER, numerics=SAME)
_add("control_reacher", REACHER, numerics=SAME)
_add("control_servo", SERVO, numerics=SAME)
_add("control_pendulum_fine", PENDULUM)
_add("control_cheetah_fine", CHEETAH)
_add("control_walker_fine", WALKER)
_add("control_servo_fine", SERVO)
_add("control_cheetah_rk4", CHEETAH, numerics=RK4)
_add("control_reacher_implicit", REACHER, numerics=Numerics(1, "implicitfast"))
_add("control_cheetah_noise_x3", CHEETAH, numerics=SAME, noise=MODELS[CHEETAH].noise.times(3))
_add("control_walker_noise_x3", WALKER, noise=MODELS[WALKER].noise.times(3))
_add("control_servo_coloured", SERVO, numerics=SAME, noise=Noise(1e-3, 1e-2, correlation=0.8))
_add("control_cheetah_coloured", CHEETAH, noise=Noise(1e-3, 1e-2, correlation=0.6))
_add("control_servo_quantised", SERVO, numerics=SAME, noise=Noise(3e-4, 1e-2, quantum=1.534e-3))
_add("control_cheetah_quiet", CHEETAH, numerics=SAME, amplitude=0.01, still=True, may_abstain=True)
_add("control_reacher_quiet", REACHER, numerics=SAME, amplitude=0.01, still=True, may_abstain=True)
_add("control_servo_quiet", SERVO, amplitude=0.02, still=True, may_abstain=True)
_add("control_hopper", HOPPER)
_add("control_swimmer", SWIMMER)
_add("control_double", DOUBLE)
_add("control_pusher", PUSHER)
