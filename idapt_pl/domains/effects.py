"""Effects: named, typed edits of an MJCF model, the one vocabulary for differences between worlds.

An effect says *what* is different (``body_mass``), *where* (``pole``) and *by how much*
(``mass: 200`` kg). A benchmark's target domain, a randomisation range, a diagnosis and a repaired
model are all lists of effects. As YAML::

    - effect: body_mass
      target: pole
      parameters: {mass: 200.0}
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.linalg import expm

EFFECTS: dict[str, type[Effect]] = {}


def parameter(unit: str, low: float, high: float, **default: Any) -> Any:
    """Declare one parameter of an effect: its SI unit and its physical bounds (inclusive)."""
    return field(metadata={"unit": unit, "low": low, "high": high}, **default)


@dataclass(frozen=True)
class Effect(ABC):
    """One edit of an ``mujoco.MjSpec``; subclasses are registered under ``name``.

    Attributes:
        target: MJCF name of the element edited, or ``"*"`` for all elements of that kind; of joints also
            ``"actuated"``.
    """

    name: ClassVar[str] = ""
    target: str

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if cls.name:
            EFFECTS[cls.name] = cls

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if isinstance(value, list):  # YAML gives lists; a frozen value must be hashable
                object.__setattr__(self, f.name, tuple(value))
            if "unit" not in f.metadata or value is None:
                continue
            try:
                numbers = np.asarray(value, dtype=float)
            except (TypeError, ValueError):
                raise ValueError(f"{self.name} on {self.target!r}: {f.name} must be numeric, got {value!r}") from None
            low, high, unit = f.metadata["low"], f.metadata["high"], f.metadata["unit"]
            if not (np.isfinite(numbers).all() and (numbers >= low).all() and (numbers <= high).all()):
                raise ValueError(
                    f"{self.name} on {self.target!r}: {f.name} = {value} {unit} is outside [{low}, {high}] {unit}"
                )

    @abstractmethod
    def apply(self, spec: mujoco.MjSpec) -> None:
        """Edit ``spec`` in place. Raises ValueError if the target does not exist."""

    def to_dict(self) -> dict[str, Any]:
        """The YAML/JSON form: ``{effect, target, parameters}`` (unset parameters left out)."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "target"}
        parameters = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if v is not None}
        return {"effect": self.name, "target": self.target, "parameters": parameters}


def effect_from_dict(entry: Mapping[str, Any]) -> Effect:
    """Build an effect from its YAML form; errors name the key and list what is known."""
    if not isinstance(entry, Mapping) or "effect" not in entry:
        raise ValueError(f"an effect needs the keys effect, target, parameters; got {entry!r}")
    name = entry["effect"]
    if name not in EFFECTS:
        raise ValueError(f"unknown effect {name!r}; known effects: {', '.join(sorted(EFFECTS))}")
    if unknown := set(entry) - {"effect", "target", "parameters"}:
        raise ValueError(f"effect {name!r}: unknown key {sorted(unknown)}; an effect has effect, target, parameters")
    try:
        return EFFECTS[name](target=entry.get("target", "*"), **entry.get("parameters", {}))
    except TypeError:
        known = [f.name for f in dataclasses.fields(EFFECTS[name]) if f.name != "target"]
        raise ValueError(
            f"effect {name!r}: parameters must be among {known}, got {sorted(entry.get('parameters', {}))}"
        ) from None


def elements(spec: mujoco.MjSpec, kind: str, target: str) -> list[Any]:
    """The elements of one kind (``"joints"``, ``"geoms"``, ...) called ``target``, or all for ``"*"``."""
    everything: Iterable[Any] = getattr(spec, kind)
    found = [e for e in everything if target in ("*", e.name)]
    if not found:
        names = ", ".join(e.name or "<unnamed>" for e in everything)
        raise ValueError(f"the model has no {kind[:-1]} named {target!r}; it has: {names or 'none'}")
    return found


ACTUATED = "actuated"
"""The target of effects on all joints that an actuator acts on: motors and gears, not the joints of a free base."""


def joints(spec: mujoco.MjSpec, target: str) -> list[Any]:
    """The joints called ``target``, all for ``"*"``, or those that actuators act on for ``"actuated"``."""
    names = [j.name for j in spec.joints]
    if target != ACTUATED or ACTUATED in names:
        return elements(spec, "joints", target)
    on_joints = {a.target for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT}
    found = [j for j in spec.joints if j.name in on_joints]
    if not found:
        raise ValueError(f"no actuator of the model acts on a joint; its joints: {', '.join(names) or 'none'}")
    return found


@dataclass(frozen=True)
class BodyMass(Effect):
    """Mass of a body. Its inertia scales along: the shape and density profile stay the same."""

    name: ClassVar[str] = "body_mass"
    mass: float = parameter("kg", 1e-6, 1e6)

    def apply(self, spec: mujoco.MjSpec) -> None:
        elements(spec, "bodies", self.target)  # raises if there is none
        twin = spec.copy()
        model = twin.compile()
        masses = [float(model.body(b.id).mass[0]) for b in twin.bodies]
        for body, now in zip(spec.bodies, masses, strict=True):
            if self.target not in ("*", body.name):
                continue
            if now == 0.0:
                if self.target == "*":
                    continue
                raise ValueError(f"body_mass: body {body.name!r} has no mass to scale")
            ratio = self.mass / now
            if body.explicitinertial:
                body.mass *= ratio
                body.inertia = np.asarray(body.inertia) * ratio
                body.fullinertia = np.asarray(body.fullinertia) * ratio
            for geom in body.geoms:
                geom.density *= ratio
                geom.mass *= ratio  # NaN (mass from density) stays NaN


@dataclass(frozen=True)
class _JointEffect(Effect):
    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in joints(spec, self.target):
            self.edit(joint)

    def edit(self, joint: Any) -> None:
        raise NotImplementedError


@dataclass(frozen=True)
class JointDamping(_JointEffect):
    """Linear joint damping."""

    name: ClassVar[str] = "joint_damping"
    damping: float = parameter("N·m·s/rad or N·s/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[0] = self.damping  # [1:] are the polynomial terms


@dataclass(frozen=True)
class JointFrictionloss(_JointEffect):
    """Dry friction of a joint (MuJoCo's soft constraint)."""

    name: ClassVar[str] = "joint_frictionloss"
    frictionloss: float = parameter("N·m or N", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.frictionloss = self.frictionloss


@dataclass(frozen=True)
class JointArmature(_JointEffect):
    """Rotor inertia reflected to the joint."""

    name: ClassVar[str] = "joint_armature"
    armature: float = parameter("kg·m² or kg", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.armature = self.armature


@dataclass(frozen=True)
class ActuatorGain(Effect):
    """Scales what a command does: 1 is nominal, 0.8 is a motor that has lost a fifth.

    Of a ``dcmotor`` it divides the resistance, which scales the torque of a voltage and the back-EMF alike.
    """

    name: ClassVar[str] = "actuator_gain"
    gain: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[0] /= max(self.gain, 1e-6)
            else:
                actuator.gainprm[0] *= self.gain


@dataclass(frozen=True)
class MotorConstant(Effect):
    """Torque constant of a ``dcmotor`` relative to nominal; its back-EMF constant goes along."""

    name: ClassVar[str] = "motor_constant"
    factor: float = parameter("1", 1e-3, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[1] *= self.factor
            elif self.target != "*":
                raise ValueError(f"motor_constant: actuator {actuator.name!r} is not a dcmotor")


@dataclass(frozen=True)
class ContactFriction(Effect):
    """Sliding friction coefficient of a geom."""

    name: ClassVar[str] = "contact_friction"
    sliding: float = parameter("1", 0.0, 1e2)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in elements(spec, "geoms", self.target):
            geom.friction[0] = self.sliding


@dataclass(frozen=True)
class GravityDirection(Effect):
    """Gravity turned away from straight down: the base stands on a slope. Target is ``"world"``."""

    name: ClassVar[str] = "gravity_direction"
    tilt_x: float = parameter("rad", -np.pi, np.pi)
    tilt_y: float = parameter("rad", -np.pi, np.pi)

    def apply(self, spec: mujoco.MjSpec) -> None:
        g = np.linalg.norm(spec.option.gravity)
        sx, cx, sy, cy = np.sin(self.tilt_x), np.cos(self.tilt_x), np.sin(self.tilt_y), np.cos(self.tilt_y)
        spec.option.gravity = g * np.array([-sy * cx, sx, -cx * cy])


@dataclass(frozen=True)
class Numerics(Effect):
    """Time step and integrator of the simulation itself. Target is ``"world"``."""

    name: ClassVar[str] = "numerics"
    timestep: float = parameter("s", 1e-6, 1.0)
    integrator: str = "Euler"

    def apply(self, spec: mujoco.MjSpec) -> None:
        kinds = {k: f"mjINT_{k.upper()}" for k in ("Euler", "RK4", "implicit", "implicitfast")}
        if self.integrator not in kinds:
            raise ValueError(f"numerics: integrator must be one of {', '.join(kinds)}, got {self.integrator!r}")
        spec.option.timestep = self.timestep
        spec.option.integrator = getattr(mujoco.mjtIntegrator, kinds[self.integrator])


def explicit_inertial(spec: mujoco.MjSpec, target: str) -> list[Any]:
    """Bodies with their mass, centre and inertia written out, as MuJoCo computes them from the geoms."""
    bodies = elements(spec, "bodies", target)
    model = spec.copy().compile()
    for body in bodies:
        compiled = model.body(body.name) if body.name else model.body(body.id)
        if not body.explicitinertial or not np.isnan(body.fullinertia[0]):
            body.explicitinertial = True
            body.mass = float(compiled.mass[0])
            body.ipos, body.iquat, body.inertia = compiled.ipos, compiled.iquat, compiled.inertia
            body.fullinertia = [np.nan, 0, 0, 0, 0, 0]  # not given
    return bodies


@dataclass(frozen=True)
class BodyCom(Effect):
    """Centre of mass of a body, moved from where the model has it, in the body's frame."""

    name: ClassVar[str] = "body_com"
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in explicit_inertial(spec, self.target):
            body.ipos = np.add(body.ipos, (self.x, self.y, self.z))


@dataclass(frozen=True)
class BodyInertia(Effect):
    """Mass, centre and rotational inertia of a body at once, relative to what the model has: ten numbers.

    The inertia about the centre, in the body's principal axes, becomes √I exp(E) √I with E symmetric, so that it stays
    positive; MuJoCo balances one that no body could have. ``rotation`` scales it as a whole.
    """

    name: ClassVar[str] = "body_inertia"
    mass: float = parameter("1", 1e-3, 1e3, default=1.0)
    rotation: float = parameter("1", 1e-3, 1e3, default=1.0)
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)
    xx: float = parameter("1", -5.0, 5.0, default=0.0)
    yy: float = parameter("1", -5.0, 5.0, default=0.0)
    xy: float = parameter("1", -5.0, 5.0, default=0.0)
    xz: float = parameter("1", -5.0, 5.0, default=0.0)
    yz: float = parameter("1", -5.0, 5.0, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in explicit_inertial(spec, self.target):
            body.mass *= self.mass
            body.ipos = np.add(body.ipos, (self.x, self.y, self.z))
            body.inertia = np.asarray(body.inertia) * self.rotation
            if any((self.xx, self.yy, self.xy, self.xz, self.yz)):
                self.deform(body)
                spec.compiler.balanceinertia = True

    def deform(self, body: Any) -> None:
        """Apply exp(E); the trace of E is zero, as ``rotation`` is there for the rest."""
        E = np.array([[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, -self.xx - self.yy]])
        root = np.diag(np.sqrt(np.asarray(body.inertia)))
        principal, axes = np.linalg.eigh(root @ expm(E) @ root)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        turn, whole = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(turn, axes.ravel())
        mujoco.mju_mulQuat(whole, np.asarray(body.iquat, float), turn)
        body.inertia, body.iquat = principal, whole


@dataclass(frozen=True)
class Payload(Effect):
    """A point mass fixed to a body, at a place in the body's frame."""

    name: ClassVar[str] = "payload"
    mass: float = parameter("kg", 0.0, 1e5)
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in elements(spec, "bodies", self.target):
            if self.mass:
                load = body.add_body(pos=(self.x, self.y, self.z))
                load.explicitinertial, load.mass, load.inertia = True, self.mass, [1e-9 * self.mass] * 3


@dataclass(frozen=True)
class JointStiffness(_JointEffect):
    """Linear spring of a joint, pulling to its ``springref``."""

    name: ClassVar[str] = "joint_stiffness"
    stiffness: float = parameter("N·m/rad or N/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.stiffness[0] = self.stiffness


@dataclass(frozen=True)
class JointSpringref(_JointEffect):
    """Where a joint's spring is at rest."""

    name: ClassVar[str] = "joint_springref"
    springref: float = parameter("rad or m", -1e3, 1e3)

    def edit(self, joint: Any) -> None:
        joint.springref = self.springref


@dataclass(frozen=True)
class JointDrag(_JointEffect):
    """Quadratic drag of a joint, against its motion: torque = -drag |v| v (MuJoCo's polynomial damping)."""

    name: ClassVar[str] = "joint_drag"
    drag: float = parameter("N·m·s²/rad² or N·s²/m²", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[1] = self.drag


PLAY = " play"
"""What the name of a joint behind another one, which is its play, ends in."""


@dataclass(frozen=True)
class JointBacklash(Effect):
    """Play in the gearbox: behind the driven joint the link turns (or slides) freely by ``width`` in all.

    It is a second joint of the same body, limited to plus and minus half the width. The model's coordinate of the
    driven joint is then that of the motor; what the link does is the sum of both.
    """

    name: ClassVar[str] = "joint_backlash"
    width: float = parameter("rad or m", 0.0, 10.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in elements(spec, "joints", self.target):
            if self.width and joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                self.loosen(spec, joint)

    def loosen(self, spec: mujoco.MjSpec, joint: Any) -> None:
        """Put the second joint behind one."""
        # without inertia of its own the motor could not be told from the link
        felt = float(spec.copy().compile().joint(joint.name).M0[0])
        joint.armature = max(joint.armature, 0.01 * felt)
        play = joint.parent.add_joint(name=joint.name + PLAY, type=joint.type, axis=joint.axis, pos=joint.pos)
        turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        half = self.width / 2 * (180 / np.pi if turns and spec.compiler.degree else 1.0)
        play.limited, play.range = True, (-half, half)
        play.armature = play.frictionloss = play.margin = play.ref = play.springref = 0.0
        play.stiffness[:] = play.damping[:] = 0.0
        play.solref_limit = (2 * spec.option.timestep, 1.0)


@dataclass(frozen=True)
class ContactSoftness(Effect):
    """Time constant of contacts (``solref[0]``): the larger, the softer."""

    name: ClassVar[str] = "contact_softness"
    time_constant: float = parameter("s", 1e-4, 1e1)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in elements(spec, "geoms", self.target):
            geom.solref[0] = self.time_constant


@dataclass(frozen=True)
class FluidDrag(Effect):
    """The medium everything moves through (MuJoCo's inertia-box model). Target is ``"world"``."""

    name: ClassVar[str] = "fluid_drag"
    density: float = parameter("kg/m³", 0.0, 1e5, default=0.0)
    viscosity: float = parameter("Pa·s", 0.0, 1e5, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        spec.option.density, spec.option.viscosity = self.density, self.viscosity


@dataclass(frozen=True)
class ActuatorKp(Effect):
    """Stiffness of a servo relative to nominal: what it does with command and position alike."""

    name: ClassVar[str] = "actuator_kp"
    factor: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            actuator.gainprm[0] *= self.factor
            actuator.biasprm[0] *= self.factor
            actuator.biasprm[1] *= self.factor


@dataclass(frozen=True)
class ActuatorKv(Effect):
    """Velocity feedback of a servo, or the back-EMF of a motor: force = -kv · velocity."""

    name: ClassVar[str] = "actuator_kv"
    kv: float = parameter("force·s/rad or force·s/m", 0.0, 1e6)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[2] = -self.kv
