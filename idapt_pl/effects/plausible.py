"""What effects can be on real machines: a range for each parameter, with its reason, and which causes are rare.

Bounds of an effect say what numbers a simulation can take. The ranges here say what an engineer would believe without
a look at the machine. A search looks inside them first (``idapt_pl/diagnosis/``); what lies outside is named last.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from idapt_pl.effects.base import ACTUATED, names_in
from idapt_pl.effects.candidate import Candidate, TypicalSizes, moved_bodies
from idapt_pl.effects.driven import ON_JOINT

DRIVEN = tuple(map(int, (*ON_JOINT, mujoco.mjtTrn.mjTRN_TENDON)))
"""Transmissions to joints: what motors have, and propellers have not."""


@dataclass(frozen=True)
class Plausible:
    """A range, in units of something that the model or the recordings say.

    Attributes:
        low: lower end.
        high: upper end.
        unit: what the ends are multiples of, a key of :data:`MEASURES`.
        reason: of the range, as the end of a sentence.
    """

    low: float
    high: float
    unit: str
    reason: str


@dataclass(frozen=True)
class Machine:
    """What ranges are measured by: a model, and sizes in its recordings."""

    model: mujoco.MjModel
    typical: TypicalSizes

    def dofs(self, target: str) -> list[int]:
        """Degrees of freedom of the joints that a target means; all where it means no joints."""
        m = self.model
        if target in ("*", ACTUATED):
            return list(range(m.nv))
        meant = names_in(target, [m.joint(j).name for j in range(m.njnt)])[-1:]  # of two, as felt at the second
        return [int(m.joint(name).dofadr[0]) for name in meant] or list(range(m.nv))

    def effort(self, c: Candidate) -> float:
        """The largest torque or force that acted on a joint."""
        return float(self.typical.effort[self.dofs(c.target)].max(initial=0.0)) if self.typical.effort.size else np.inf

    def speed(self, c: Candidate) -> float:
        """Usual speed of a joint."""
        return float(self.typical.speed[self.dofs(c.target)].min())

    def mass(self) -> float:
        """Of all that moves, kg."""
        return float(sum(self.model.body_mass[b] for b, _ in moved_bodies(self.model)))

    def command(self, c: Candidate) -> float:
        """Twice the usual command of an actuator."""
        names = [self.model.actuator(i).name for i in range(self.model.nu)]
        own = [i for i, name in enumerate(names) if c.target in ("*", name)]
        return 2 * float(self.typical.command[own].max(initial=0.0)) or np.inf

    def force(self, c: Candidate) -> float:
        """Usual force of an actuator in the nominal model."""
        own = [i for i in range(self.model.nu) if c.target in ("*", self.model.actuator(i).name)]
        return float(self.typical.force[own].max(initial=0.0)) or np.inf

    def pulls_both_ways(self, c: Candidate) -> float:
        """1 if an actuator drives a joint or tendon in both directions, infinite where one does not."""
        m = self.model
        own = [i for i in range(m.nu) if c.target in ("*", m.actuator(i).name)]
        both = [not m.actuator_ctrllimited[i] or m.actuator_ctrlrange[i, 0] < 0 for i in own]
        return 1.0 if all(both) and all(m.actuator_trntype[i] in DRIVEN for i in own) else np.inf

    def link(self) -> float:
        """The longest way from a joint to the next, or from the last one to where its body ends, m."""
        moved = [b for b, _ in moved_bodies(self.model)]
        inner = [b for b in moved if self.model.body_weldid[self.model.body_parentid[b]] != 0]
        steps = np.linalg.norm(self.model.body_pos[inner], axis=1) if inner else np.zeros(0)
        return max(float(steps.max(initial=0.0)), *(self.reach(b) for b in moved))

    def inertia(self, c: Candidate) -> float:
        """The largest inertia of the mechanism about a joint of the same kind, kg·m² or kg."""
        turns = self.model.jnt_type[self.model.dof_jntid] != mujoco.mjtJoint.mjJNT_SLIDE
        alike = turns == turns[self.dofs(c.target)[0]]
        return float(self.typical.inertia[alike].max())

    def length(self, c: Candidate) -> float:
        """How far a body reaches from its frame, m."""
        return self.reach(self.model.body(c.target).id)

    def reach(self, b: int) -> float:
        """The same by the body's number."""
        gyration = np.sqrt(self.model.body_inertia[b].max() / max(self.model.body_mass[b], 1e-9))
        return float(np.linalg.norm(self.model.body_ipos[b]) + 2 * gyration)


Measure = Callable[[Machine, Candidate, int], float]
MEASURES: dict[str, Measure] = {
    "": lambda m, c, k: 1.0,
    "of the model's": lambda m, c, k: abs(c.nominal[k]),
    "of what drives it": lambda m, c, k: m.effort(c),
    "of what drives it, over its speed": lambda m, c, k: m.effort(c) / m.speed(c),
    "of what drives it, over its squared speed": lambda m, c, k: m.effort(c) / m.speed(c) ** 2,
    "of what drives it, over 0.1": lambda m, c, k: 10 * m.effort(c),
    "of the weight": lambda m, c, k: 9.81 * m.mass(),
    "of the moved mass": lambda m, c, k: m.mass(),
    "of the largest command": lambda m, c, k: m.command(c),
    "of the largest inertia": lambda m, c, k: m.inertia(c),
    "of the body's reach": lambda m, c, k: m.length(c),
    "of the longest link": lambda m, c, k: m.link(),
    "of its usual speed": lambda m, c, k: m.speed(c),
    "of the usual force": lambda m, c, k: m.force(c),
    "where a motor pulls both ways": lambda m, c, k: m.pulls_both_ways(c),
}
"""What the ends of ranges are multiples of, by words that follow a number."""

FRICTION = "a joint that moves is not held by its own friction"
COUNTERPARTS = "parts are drawn and weighed better than that: more is another part, or another model"
WEIGHED = Plausible(0.3, 3.2, "of the model's", COUNTERPARTS)
CENTRE = Plausible(-1.0, 1.0, "of the body's reach", "a centre of mass lies within its body")
HELD = Plausible(-1.5, 1.5, "of the longest link", "a load is on its link, or in a tool that is no longer than a link")
DATASHEET = "data sheets, batteries and windings are off by tens of per cents, not by multiples"
MOTOR = Plausible(0.3, 3.2, "of the model's", DATASHEET)
TILT = Plausible(-0.26, 0.26, "", "machines are set up by eye and stand within 15° of what was meant")
PUSHED = Plausible(-0.5, 0.5, "of the weight", "cables and fans pull with a fraction of what the machine weighs")
CABLES = "cables let a joint turn round twice at most"
LATE = "buses and controllers take milliseconds to tens of them; 0.2 s would be a fault of the clocks"

PLAUSIBLE: dict[tuple[str, str], Plausible] = {
    ("joint_damping", "damping"): Plausible(0.0, 3.0, "of what drives it, over its speed", FRICTION),
    ("joint_frictionloss", "frictionloss"): Plausible(0.0, 1.5, "of what drives it", FRICTION),
    ("joint_stribeck", "coulomb"): Plausible(0.0, 1.5, "of what drives it", FRICTION),
    ("joint_stribeck", "static"): Plausible(0.0, 2.0, "of what drives it", FRICTION),
    ("joint_stribeck", "speed"): Plausible(
        0.0, 3.0, "of its usual speed", "friction that still falls where the joint is fastest is no film of oil"
    ),
    ("joint_drag", "drag"): Plausible(0.0, 3.0, "of what drives it, over its squared speed", FRICTION),
    ("joint_armature", "armature"): Plausible(
        0.0, 10.0, "of the largest inertia", "gears are chosen so that a rotor feels about as heavy as its load"
    ),
    ("joint_stiffness", "stiffness"): Plausible(
        0.0, 3.0, "of what drives it, over 0.1", "a stiffer spring would hold the joint within 0.1 rad (0.1 m)"
    ),
    ("joint_springref", "springref"): Plausible(-3.2, 3.2, "", "half a turn away is as far as an angle goes"),
    **{("joint_range", end): Plausible(-13.0, 13.0, "", CABLES) for end in ("lower", "upper")},
    ("joint_backlash", "width"): Plausible(0.0, 0.2, "", "worn gears of toys have play of a few degrees"),
    ("joint_cogging", "sine"): Plausible(-1.0, 1.0, "of what drives it", "a motor overcomes its own cogging"),
    ("joint_cogging", "cosine"): Plausible(-1.0, 1.0, "of what drives it", "a motor overcomes its own cogging"),
    ("joint_cogging", "periods"): Plausible(1.0, 100.0, "", "motors have some tens of poles and slots"),
    ("shared_motor", "damping"): Plausible(0.0, 3.0, "of what drives it, over its speed", FRICTION),
    ("shared_motor", "frictionloss"): Plausible(0.0, 1.5, "of what drives it", FRICTION),
    ("shared_motor", "armature"): Plausible(
        0.0, 10.0, "of the largest inertia", "gears are chosen so that a rotor feels about as heavy as its load"
    ),
    ("shared_motor", "ratio"): Plausible(-3.0, 3.0, "", "belts and bevel gears between joints go one to one, or near"),
    ("body_mass", "mass"): WEIGHED,
    ("body_inertia", "mass"): WEIGHED,
    ("body_inertia", "rotation"): Plausible(0.2, 5.0, "of the model's", COUNTERPARTS),
    **{("body_inertia", how): Plausible(-1.6, 1.6, "", COUNTERPARTS) for how in ("xx", "yy", "xy", "xz", "yz")},
    **{(effect, axis): CENTRE for effect in ("body_com", "body_inertia") for axis in "xyz"},
    ("payload", "mass"): Plausible(0.0, 1.0, "of the moved mass", "machines carry no more than they weigh"),
    **{("payload", axis): HELD for axis in "xyz"},
    ("actuator_gain", "gain"): MOTOR,
    ("motor_constant", "factor"): MOTOR,
    ("motor_resistance", "factor"): MOTOR,
    ("motor_strength", "factor"): MOTOR,
    ("actuator_kp", "factor"): Plausible(
        0.01, 100.0, "of the model's", "published models of servos have gains thirty times off"
    ),
    ("actuator_kv", "kv"): Plausible(
        0.0, 1.0, "of what drives it, over its speed", "a servo that brakes harder than it can push does not get there"
    ),
    ("actuator_bias", "bias"): Plausible(-0.5, 0.5, "of the largest command", "an offset that large is seen at rest"),
    ("actuator_deadzone", "width"): Plausible(
        0.0, 0.5, "of the largest command", "a motor that ignores half of its commands is broken"
    ),
    ("actuator_curve", "share"): Plausible(
        -0.4, 0.4, "where a motor pulls both ways", "motors pull about in proportion; propellers and valves do not"
    ),
    ("actuator_saturation", "limit"): Plausible(
        0.1, np.inf, "of the largest command", "a motor that does a tenth of what it is told is broken"
    ),
    ("actuator_saturation", "force"): Plausible(
        0.003,
        np.inf,
        "of the usual force",
        "a servo can move what it drives, though models have gains thirty times off",
    ),
    ("actuator_rotation", "angle"): Plausible(-np.pi, np.pi, "", "a base may be bolted down any way round"),
    ("actuator_delay", "delay"): Plausible(0.0, 0.2, "", LATE),
    ("actuator_lag", "time_constant"): Plausible(0.0, 0.3, "", LATE),
    ("actuator_lag", "dead_time"): Plausible(-0.02, 0.2, "", LATE),
    ("sensor_bias", "bias"): Plausible(-0.35, 0.35, "", "zeros are set by eye; beyond 20° it is seen at once"),
    ("sensor_gain", "gain"): Plausible(0.8, 1.25, "", "encoders are off by per cents, or by a unit"),
    ("contact_friction", "sliding"): Plausible(0.02, 2.0, "", "wet ice has 0.02, rubber on dry concrete 1 to 1.5"),
    ("contact_friction", "torsional"): Plausible(0.0, 0.1, "", "it is friction times the size of the contact"),
    ("contact_friction", "rolling"): Plausible(0.0, 0.1, "", "soft tyres on sand have some centimetres"),
    ("contact_softness", "time_constant"): Plausible(5e-4, 0.2, "", "hard things part in milliseconds, foam in tenths"),
    ("contact_softness", "damping_ratio"): Plausible(5e-3, 3.0, "", "the best balls lose some per cent in a bounce"),
    ("gravity_direction", "tilt_x"): TILT,
    ("gravity_direction", "tilt_y"): TILT,
    **{("external_force", axis): PUSHED for axis in "xyz"},
}
"""Ranges by effect and parameter: of every effect of ours that is searched; those of others can be anything."""

AIR = {
    "density": Plausible(0.0, 3.0, "", "air has 1.2 kg/m³, a little more where a shape is not a box"),
    "viscosity": Plausible(0.0, 1e-4, "", "air has 0.00002 Pa·s: a thicker medium would be known"),
}
LIQUID = {
    "density": Plausible(0.2, 5.0, "of the model's", "a liquid is known better"),
    "viscosity": Plausible(0.1, 10.0, "of the model's", "viscosity changes with temperature, by some times"),
}
"""Of ``fluid_drag``, by whether the model has a medium."""

RARITY = {
    "external_force": 0.05,
    "sensor_bias": 0.05,
    "sensor_gain": 0.05,
    "fluid_drag": 0.03,
    "joint_cogging": 0.03,
    "actuator_deadzone": 0.05,
    "actuator_curve": 0.05,
    "actuator_rotation": 0.05,
    "shared_motor": 0.05,
}
"""Share of its gain by which a rare cause must be better than a common one: such effects imitate much.

Friction, masses, gains and delays are off on nearly every machine. Sensors that are, unseen hands, a medium that nobody
knows of, motors deaf to small commands, curved ones and crossed wires are not."""


def plausible_range(effect: str, parameter: str, nominal: float) -> Plausible | None:
    """The range of a parameter; None where there is none."""
    if effect == "fluid_drag":
        return (LIQUID if nominal else AIR).get(parameter)
    return PLAUSIBLE.get((effect, parameter))


def with_plausible_ends(c: Candidate, machine: Machine) -> Candidate:
    """A candidate that knows what is plausible, and starts nowhere else.

    The value that the model has is plausible, whatever it is.
    """
    low, high = (b.copy() for b in c.bounds())
    for k, name in enumerate(c.names):
        entry = plausible_range(c.kind.name, name, c.nominal[k])
        if entry is None:
            continue
        unit = MEASURES[entry.unit](machine, c, k)
        if np.isfinite(unit) and unit > 0:
            low[k] = max(low[k], min(entry.low * unit, c.nominal[k]))
            high[k] = max(low[k], min(high[k], max(entry.high * unit, c.nominal[k])))  # a joint at rest has no size
    inside = tuple(s for s in c.starts if (np.asarray(s) > low - 1e-12).all() and (np.asarray(s) < high + 1e-12).all())
    return replace(c, starts=inside, plausible=tuple(zip(low.tolist(), high.tolist(), strict=True)))


def rarity(c: Candidate) -> float:
    """Of a candidate, as in :data:`RARITY`."""
    return RARITY.get(c.kind.name, 0.0)
