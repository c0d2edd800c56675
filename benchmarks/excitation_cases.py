"""Confounded first recordings for benchmarks/excitation.py: what is hidden, and how little the first motion shows.

The worlds and effects are made by benchmarks/undeclared. The first recordings are too small or too slow to tell what
is missing; how small was chosen by looking at seed 0 of the pendulum and the servo arm. ``QUIET_ARMS`` are the arms of
benchmarks/undeclared, each of whose single effects is recorded as quietly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from benchmarks.undeclared import hidden
from benchmarks.undeclared.cases import CASES, SAME, Case
from benchmarks.undeclared.hidden import Part
from benchmarks.undeclared.models import MODELS, Model, Noise

HANGING = """<mujoco model="hanging pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.007 0.007 0.0002"/>
      <joint name="hinge" type="hinge" axis="0 1 0" range="-3 3" limited="true" damping="0.03" armature="0.004"
             frictionloss="0.01"/>
      <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="hinge" gear="1" ctrllimited="true" ctrlrange="-1.2 1.2"/>
  </actuator>
</mujoco>
"""
"""A pendulum with a motor, from below: 1 N·m holds it level."""

TWO_LINK = """<mujoco model="two-link arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0004"/>
      <joint name="shoulder" type="hinge" axis="0 1 0" range="-2.5 2.5" limited="true" damping="0.08" armature="0.01"
             frictionloss="0.03"/>
      <geom name="upper" type="capsule" size="0.025" fromto="0 0 0 0 0 -0.3"/>
      <body name="lower" pos="0 0 -0.3">
        <inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.0016 0.0016 0.0002"/>
        <joint name="elbow" type="hinge" axis="0 1 0" range="-2.5 2.5" limited="true" damping="0.04" armature="0.004"
               frictionloss="0.015"/>
        <geom name="lower" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.22"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" gear="1" ctrllimited="true" ctrlrange="-3 3"/>
    <motor name="elbow" joint="elbow" gear="1" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
"""Two links that hang, a motor at each joint."""

OWN_MODELS = {
    "hanging_pendulum": Model(
        build=lambda: HANGING, frame_skip=10, episodes=4, steps=(110, 150), amplitude=(0.6,), fastest=2.0,
        start=((-0.1, 0.1),), start_speed=0.0, noise=Noise(1e-3, 1e-2),
    ),
    "two_link": Model(
        build=lambda: TWO_LINK, frame_skip=10, episodes=4, steps=(110, 150), amplitude=(1.2, 0.4), fastest=2.0,
        start=((-0.1, 0.1), (-0.1, 0.1)), start_speed=0.0, noise=Noise(1e-3, 1e-2),
    ),
}  # fmt: skip
MODELS.update(OWN_MODELS)

Answers = frozenset[tuple[str, str]]
"""Effects, each with what it acts on."""


@dataclass(frozen=True)
class Confounded:
    """A first recording that shows too little, and what may be recorded next.

    Attributes:
        name: of the case.
        world: what is hidden in which model.
        amplitude: of the first commands, a factor on the model's.
        kinds: of excitation, one for each first episode.
        position: limits of all joints for further motions, rad.
        velocity: likewise, rad/s.
        answers: the truth, and what is the same as it whatever the motion.
    """

    name: str
    world: Case
    amplitude: float
    kinds: tuple[str, ...]
    position: tuple[float, float]
    velocity: float
    answers: Answers

    @property
    def model(self) -> str:
        """Key of the model."""
        return self.world.model

    @property
    def start(self) -> tuple[float, ...]:
        """True positions that further motions begin at."""
        return (0.0,) * len(MODELS[self.model].start)


CONFOUNDED: dict[str, Confounded] = {}
IN_SIGHT = range(5)
"""Seeds that were looked at while the method was made, of some of the cases at least."""
LIMITS = {"hanging_pendulum": ((-0.4, 0.4), 1.5), "servo_arm": ((-0.5, 0.5), 1.0), "two_link": ((-0.4, 0.4), 1.5)}
"""Positions and speeds, rad and rad/s: narrow, as where people or walls are near."""
QUIET = ("low", "low", "low", "low")


def _add(
    name: str, model: str, part: Part, amplitude: float, also: tuple[tuple[str, str], ...] = (),
    kinds: tuple[str, ...] = QUIET,
) -> None:  # fmt: skip
    """Register a case; ``also`` is what no motion can tell from the truth."""
    truth = (part.truth.effect, part.truth.target)
    every = frozenset({truth, *also})
    world = Case(name, model, (part.truth,), "single", (frozenset({truth}),), (part,), SAME, MODELS[model].noise)
    CONFOUNDED[name] = Confounded(name, world, amplitude, kinds, *LIMITS[model], every)


def _rubbing(joint: str, actuator: str, single: bool = False) -> tuple[tuple[str, str], ...]:
    """What is viscous friction by other names: feedback of the velocity; of a single joint also that of all."""
    same = [("joint_damping", joint), ("actuator_kv", actuator)]
    return (*same, ("joint_damping", "*"), ("actuator_kv", "*")) if single else tuple(same)


def _dry(joint: str) -> tuple[tuple[str, str], ...]:
    """Dry friction: a Stribeck law has it as a special case."""
    return (("joint_frictionloss", joint), ("joint_stribeck", joint))


P, T, S = "hanging_pendulum", "two_link", "servo_arm"
_VISCOUS = (*_rubbing("hinge", "drive", single=True), ("fluid_drag", "world"))
_add("pendulum_friction", P, hidden.joint_frictionloss("hinge", 0.05), 0.5, _dry("hinge"))
_add("pendulum_damping", P, hidden.joint_damping("hinge", 0.06), 0.5, _VISCOUS)
_add("pendulum_armature", P, hidden.joint_armature("hinge", 0.012), 0.5, (("joint_armature", "*"),))
_add("pendulum_gain", P, hidden.motor_gain("drive", 0.85), 0.5, (("actuator_gain", "*"),))
_add("pendulum_bias", P, hidden.command_bias("drive", 0.025), 0.5, (("actuator_bias", "*"),))
_add("pendulum_cable", P, hidden.joint_stiffness("hinge", 0.15), 0.5, (("joint_stiffness", "*"),))
_add("pendulum_deadzone", P, hidden.deadzone("drive", 0.05), 0.5, (("actuator_deadzone", "*"),))
_add("servo_elbow_friction", S, hidden.joint_frictionloss("elbow", 0.3), 0.25, _dry("elbow"))
_add("servo_elbow_gain", S, hidden.command_gain("elbow", 0.94), 0.25)
_add("servo_forearm_com", S, hidden.body_com("forearm", (0.03, 0.0, 0.03)), 0.25, (("body_inertia", "forearm"),))
_add("two_link_elbow_friction", T, hidden.joint_frictionloss("elbow", 0.05), 0.5, _dry("elbow"))
_add("two_link_shoulder_damping", T, hidden.joint_damping("shoulder", 0.2), 0.5, _rubbing("shoulder", "shoulder"))
_add("two_link_elbow_armature", T, hidden.joint_armature("elbow", 0.01), 0.5)
_add("two_link_elbow_gain", T, hidden.motor_gain("elbow", 0.85), 0.5)
_add("two_link_lower_mass", T, hidden.body_mass("lower", 0.46), 0.5, (("body_inertia", "lower"),))
_TURNED = (("sensor_bias", "shoulder"),)  # in a plane a tilted base is the same as another zero of the first joint
_add("two_link_tilt", T, hidden.tilt(tilt_y=0.05), 0.5, _TURNED)

QUIET_ARMS = ("servo_arm", "reacher", "pusher", "dc_arm")
"""Of these, every single effect that is not above; not cogging, which nobody looks for within a fraction of a turn."""
LIMITS |= {"reacher": ((-0.5, 0.5), 1.5), "pusher": ((-0.5, 0.5), 1.0), "dc_arm": ((-0.5, 0.5), 1.5)}


def _add_recorded_quietly(world: Case) -> None:
    """Register a case of benchmarks/undeclared, unless it is there by another name."""
    effect, target = world.truth[0].effect, world.truth[0].target
    same = {"joint_frictionloss": _dry(target), "joint_damping": _rubbing(target, target)}.get(effect, ())
    answers = frozenset({(effect, target), *same}).union(*world.accept)
    known = any(c.model == world.model and (effect, target) in c.answers for c in CONFOUNDED.values())
    if effect != "joint_cogging" and not known:
        world = replace(world, numerics=SAME)
        CONFOUNDED[world.name] = Confounded(world.name, world, 0.25, QUIET, *LIMITS[world.model], answers)


for _world in CASES.values():
    if _world.model in QUIET_ARMS and len(_world.truth) == 1 and _world.accept and _world.amplitude == 1:
        _add_recorded_quietly(_world)
