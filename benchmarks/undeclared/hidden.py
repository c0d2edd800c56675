"""What a recording can hide: each function returns a :class:`Part` to put between the nominal model and the truth.

A part says what it is in the vocabulary of ``idapt diagnose`` (:class:`Truth`) and how the data generator makes
it: an edit of the MJCF text, a force added in every physics step, a change of the command on its way to the
actuator, or a change of the measurement. Nothing here knows how the code under test expresses the same effect.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

Edit = Callable[[ET.Element], None]
Force = Callable[[mujoco.MjModel, mujoco.MjData], None]  # called before each physics step, applied forces are zero
Command = Callable[[np.ndarray, float], np.ndarray]  # (command, time) -> what reaches the actuators, same units
Sensor = Callable[[np.ndarray, np.ndarray], None]  # edits measured qpos and qvel of the nominal joints in place

PLAY = "_play"  # suffix of the joint that a backlash adds; it moves with the joint it is named after


@dataclass(frozen=True)
class Truth:
    """One undeclared effect.

    Attributes:
        effect, target: in the vocabulary of ``idapt diagnose``.
        parameter: the one that was changed.
        value: of it, in SI or command units; None where an estimate cannot be compared with one number.
    """

    effect: str
    target: str
    parameter: str
    value: float | None


@dataclass(frozen=True)
class Part:
    """One hidden change, and how to make it.

    Attributes:
        truth: what it is.
        edit: of the MJCF.
        force: a factory, called once an episode with the true model.
        command: a factory, called once an episode with the true model.
        sensor: a factory, called with the nominal model.
        sensor_delay: s, of all measurements.
    """

    truth: Truth
    edit: Edit | None = None
    force: Callable[[mujoco.MjModel], Force] | None = None
    command: Callable[[mujoco.MjModel], Command] | None = None
    sensor: Callable[[mujoco.MjModel], Sensor] | None = None
    sensor_delay: float = 0.0


# --- MJCF text ----------------------------------------------------------------------------------------


def _find(root: ET.Element, tag: str, name: str) -> ET.Element:
    """A body, joint or geom."""
    return next(element for element in root.find("worldbody").iter(tag) if element.get("name") == name)


def _actuator(root: ET.Element, name: str) -> ET.Element:
    return next(element for element in root.find("actuator") if element.get("name") == name)


def _joint(name: str, **attributes: float) -> Edit:
    def edit(root: ET.Element) -> None:
        for key, value in attributes.items():
            _find(root, "joint", name).set(key, str(value))

    return edit


def _scale(element: ET.Element, attribute: str, factor: float) -> None:
    numbers = [float(x) * factor for x in element.get(attribute).split()]
    element.set(attribute, " ".join(f"{x:.12g}" for x in numbers))


def _explicit_inertial(root: ET.Element, body: str) -> ET.Element:
    """The <inertial> of a body; made from its geoms if it has none."""
    element = _find(root, "body", body)
    if element.find("inertial") is None:
        model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        i = model.body(body).id
        write = lambda numbers: " ".join(f"{x:.12g}" for x in numbers)  # noqa: E731
        inertial = ET.Element("inertial")
        inertial.set("pos", write(model.body_ipos[i]))
        inertial.set("quat", write(model.body_iquat[i]))
        inertial.set("mass", f"{model.body_mass[i]:.12g}")
        inertial.set("diaginertia", write(model.body_inertia[i]))
        element.insert(0, inertial)
    return element.find("inertial")


def joint_damping(joint: str, damping: float) -> Part:
    """Viscous friction."""
    return Part(Truth("joint_damping", joint, "damping", damping), _joint(joint, damping=damping))


def joint_frictionloss(joint: str, frictionloss: float) -> Part:
    """Dry friction, as MuJoCo has it."""
    truth = Truth("joint_frictionloss", joint, "frictionloss", frictionloss)
    return Part(truth, _joint(joint, frictionloss=frictionloss))


def joint_armature(joint: str, armature: float) -> Part:
    """Rotor inertia."""
    return Part(Truth("joint_armature", joint, "armature", armature), _joint(joint, armature=armature))


def shared_motor(first: str, second: str, frictionloss: float, damping: float, ratio: float = 1.0) -> Part:
    """Friction at a shaft that turns by the second joint's angle and ``ratio`` of the first one's."""

    def edit(root: ET.Element) -> None:
        tendons = root.find("tendon")
        tendons = ET.SubElement(root, "tendon") if tendons is None else tendons
        shaft = ET.SubElement(tendons, "fixed", frictionloss=str(frictionloss), damping=str(damping))
        for joint, turns in ((first, ratio), (second, 1.0)):
            ET.SubElement(shaft, "joint", joint=joint, coef=str(turns))

    return Part(Truth("shared_motor", f"{first} {second}", "frictionloss", frictionloss), edit)


def joint_stiffness(joint: str, stiffness: float) -> Part:
    """A spring at the joint."""
    return Part(Truth("joint_stiffness", joint, "stiffness", stiffness), _joint(joint, stiffness=stiffness))


def joint_springref(joint: str, springref: float) -> Part:
    """Rest angle of the joint's spring."""
    return Part(Truth("joint_springref", joint, "springref", springref), _joint(joint, springref=springref))


def joint_end(joint: str, end: str, at: float) -> Part:
    """The ``lower`` or ``upper`` stop of a joint elsewhere, rad or m; a joint without stops gets this one alone."""

    def edit(root: ET.Element) -> None:
        element, compiler = _find(root, "joint", joint), root.find("compiler")
        degrees = element.get("type") != "slide" and (compiler is None or compiler.get("angle") != "radian")
        own = (element.get("range") or "-6000 6000").split()
        own[("lower", "upper").index(end)] = str(np.degrees(at) if degrees else at)
        element.set("range", " ".join(own))
        element.set("limited", "true")

    return Part(Truth("joint_range", joint, end, at), edit)


def body_mass(body: str, mass: float) -> Part:
    """A heavier or lighter body of the same shape, kg; its inertia scales along."""

    def edit(root: ET.Element) -> None:
        element = _find(root, "body", body)
        if (inertial := element.find("inertial")) is not None:
            factor = mass / float(inertial.get("mass"))
            _scale(inertial, "mass", factor)
            _scale(inertial, "diaginertia", factor)
        else:
            geoms = element.findall("geom")
            factor = mass / sum(float(geom.get("mass")) for geom in geoms)
            for geom in geoms:
                _scale(geom, "mass", factor)

    return Part(Truth("body_mass", body, "mass", mass), edit)


def body_com(body: str, shift: tuple[float, float, float]) -> Part:
    """Centre of mass moved by ``shift``, m in the body's frame."""

    def edit(root: ET.Element) -> None:
        inertial = _explicit_inertial(root, body)
        moved = np.array(inertial.get("pos").split(), float) + shift
        inertial.set("pos", " ".join(f"{x:.12g}" for x in moved))

    return Part(Truth("body_com", body, "pos", None), edit)


def payload(body: str, mass: float, pos: tuple[float, float, float], radius: float = 0.04) -> Part:
    """A solid ball welded to a body at ``pos`` of its frame."""

    def edit(root: ET.Element) -> None:
        inertia = 0.4 * mass * radius**2
        ball = ET.SubElement(_find(root, "body", body), "body", name="hidden_payload", pos=" ".join(map(str, pos)))
        ET.SubElement(ball, "inertial", pos="0 0 0", mass=str(mass), diaginertia=" ".join([str(inertia)] * 3))

    return Part(Truth("payload", body, "mass", mass), edit)


def motor_gain(actuator: str, gain: float) -> Part:
    """A motor that is weaker or stronger than it should be; ``"*"`` for all."""

    def edit(root: ET.Element) -> None:
        for motor in root.find("actuator"):
            if actuator in ("*", motor.get("name")):
                _scale(motor, "gear", gain)

    return Part(Truth("actuator_gain", actuator, "gain", gain), edit)


def servo_stiffness(actuator: str, factor: float) -> Part:
    """A position servo whose proportional gain is off (set-point and feedback alike)."""
    truth = Truth("actuator_gain", actuator, "gain", None)
    return Part(truth, lambda root: _scale(_actuator(root, actuator), "kp", factor))


def servo_strength(actuator: str, factor: float) -> Part:
    """A position servo whose motor gives less than its drive asks for; ``"*"`` for all servos."""

    def edit(root: ET.Element) -> None:
        for element in root.find("actuator").iter("position"):
            if actuator in ("*", element.get("name")):
                element.set("kp", repr(factor * float(element.get("kp"))))
                element.set("kv", repr(factor * float(element.get("kv"))))

    return Part(Truth("motor_strength", actuator, "factor", factor), edit)


def force_limit(actuator: str, limit: float) -> Part:
    """An actuator that cannot push harder than ``limit`` (before the gear)."""

    def edit(root: ET.Element) -> None:
        _actuator(root, actuator).set("forcelimited", "true")
        _actuator(root, actuator).set("forcerange", f"{-limit} {limit}")

    return Part(Truth("actuator_saturation", actuator, "limit", limit), edit)


def contact_friction(geom: str, sliding: float) -> Part:
    """Sliding friction of a geom; ``"*"`` for all."""

    def edit(root: ET.Element) -> None:
        if geom == "*":
            for element in root.find("worldbody").iter("geom"):
                element.set("friction", f"{sliding} 0.1 0.1")
        else:
            _find(root, "geom", geom).set("friction", f"{sliding} 0.1 0.1")

    return Part(Truth("contact_friction", geom, "sliding", sliding), edit)


def contact_softness(time_constant: float) -> Part:
    """Softer contacts everywhere."""

    def edit(root: ET.Element) -> None:
        for element in root.find("worldbody").iter("geom"):
            element.set("solref", f"{time_constant} 1")

    return Part(Truth("contact_softness", "*", "time_constant", time_constant), edit)


def contact_law(effect: str, parameter: str, value: float) -> Part:
    """Every contact alike: ``bounce`` (damping ratio below 1), ``torsional`` or ``rolling`` friction (m)."""
    place = {"sliding": 0, "torsional": 1, "rolling": 2}

    def edit(root: ET.Element) -> None:
        for element in root.find("worldbody").iter("geom"):
            if effect == "contact_softness":
                element.set("solref", f"0.02 {value}")
            else:
                numbers = element.get("friction", "1 0.005 0.0001").split()
                numbers[place[parameter]] = str(value)
                element.set("friction", " ".join(numbers))

    return Part(Truth(effect, "*", parameter, value), edit)


def motor(actuator: str, constant: float = 1.0, resistance: float = 1.0) -> Part:
    """A direct-current motor whose torque constant or resistance is another, in multiples; one of them must be 1."""
    attribute, factor = ("motorconst", constant) if constant != 1.0 else ("resistance", resistance)
    name = {"motorconst": "motor_constant", "resistance": "motor_resistance"}[attribute]

    def edit(root: ET.Element) -> None:
        _scale(_actuator(root, actuator), attribute, factor)

    return Part(Truth(name, actuator, "factor", factor), edit)


def fluid(parameter: str, value: float) -> Part:
    """A medium; parameter is ``viscosity`` (Pa·s) or ``density`` (kg/m³)."""

    def edit(root: ET.Element) -> None:
        root.find("option").set(parameter, str(value))

    return Part(Truth("fluid_drag", "world", parameter, value), edit)


def tilt(tilt_x: float = 0.0, tilt_y: float = 0.0) -> Part:
    """Gravity turned about x, then y, rad; one of them must be zero. The truth gives the other."""
    turned = {
        "tilt_x": (0.0, np.sin(tilt_x), -np.cos(tilt_x)),
        "tilt_y": (-np.sin(tilt_y), 0.0, -np.cos(tilt_y)),
    }
    parameter, value = ("tilt_x", tilt_x) if tilt_x else ("tilt_y", tilt_y)

    def edit(root: ET.Element) -> None:
        root.find("option").set("gravity", " ".join(f"{9.81 * x:.12g}" for x in turned[parameter]))

    return Part(Truth("gravity_direction", "world", parameter, value), edit)


def backlash(joint: str, half_width: float) -> Part:
    """Play behind the gearbox: the link turns freely within plus and minus ``half_width`` of the driven joint."""

    def edit(root: ET.Element) -> None:
        parent = next(b for b in root.iter("body") if any(j.get("name") == joint for j in b.findall("joint")))
        driven = _find(root, "joint", joint)
        play = ET.Element("joint", name=joint + PLAY, type="hinge", axis=driven.get("axis"), limited="true")
        degrees = root.find("compiler").get("angle") != "radian"
        limit = np.degrees(half_width) if degrees else half_width
        play.set("pos", driven.get("pos", "0 0 0"))
        play.set("range", f"{-limit:.12g} {limit:.12g}")
        for key, value in {"damping": "0.01", "armature": "0", "stiffness": "0", "solreflimit": "0.004 1"}.items():
            play.set(key, value)
        parent.insert(list(parent).index(driven) + 1, play)

    return Part(Truth("joint_backlash", joint, "width", None), edit)


def foot_length(geom: str, body: str, factor: float) -> Part:
    """A longer foot: a kinematic change that no effect of the library describes."""

    def edit(root: ET.Element) -> None:
        element = _find(root, "geom", geom)
        radius, half = (float(x) for x in element.get("size").split())
        element.set("size", f"{radius} {half * factor}")
        x, y, z = (float(v) for v in element.get("pos").split())
        element.set("pos", f"{x + half * (factor - 1)} {y} {z}")

    return Part(Truth("link_length", body, "length", None), edit)


# --- forces, every physics step -----------------------------------------------------------------------


def external_force(body: str, force: tuple[float, float, float]) -> Part:
    """A constant force on a body's centre of mass, N in the world frame. The truth names its largest component."""
    largest = int(np.argmax(np.abs(force)))

    def start(model: mujoco.MjModel) -> Force:
        i = model.body(body).id

        def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.xfrc_applied[i, :3] += force

        return push

    return Part(Truth("external_force", body, ("fx", "fy", "fz")[largest], force[largest]), force=start)


def periodic_push(body: str, amplitude: tuple[float, float, float], frequency: float) -> Part:
    """A shaking force on a body, Hz; its phase is counted from the start of the episode."""

    def start(model: mujoco.MjModel) -> Force:
        i = model.body(body).id

        def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.xfrc_applied[i, :3] += np.sin(2 * np.pi * frequency * data.time) * np.array(amplitude)

        return push

    return Part(Truth("periodic_force", body, "amplitude", None), force=start)


def stribeck(joint: str, coulomb: float, static: float, speed: float) -> Part:
    """Dry friction that falls from ``static`` to ``coulomb`` (N·m) within about ``speed`` (rad/s)."""

    def start(model: mujoco.MjModel) -> Force:
        dof = int(model.joint(joint).dofadr[0])

        def rub(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            fall = np.exp(-((data.qvel[dof] / speed) ** 2))
            model.dof_frictionloss[dof] = coulomb + (static - coulomb) * fall

        return rub

    return Part(Truth("joint_stribeck", joint, "friction", None), force=start)


def cogging(joint: str, amplitude: float, poles: int) -> Part:
    """A torque ``amplitude`` · sin(``poles`` · q), N·m."""

    def start(model: mujoco.MjModel) -> Force:
        dof, at = int(model.joint(joint).dofadr[0]), int(model.joint(joint).qposadr[0])

        def cog(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[dof] += amplitude * np.sin(poles * data.qpos[at])

        return cog

    return Part(Truth("joint_cogging", joint, "amplitude", None), force=start)


def servo_fade(actuator: str, loss: float, time_constant: float) -> Part:
    """A servo that warms up: its torque falls by the share ``loss``, exponentially from the start of the episode."""

    def start(model: mujoco.MjModel) -> Force:
        i = model.actuator(actuator).id
        gain, bias = model.actuator_gainprm[i].copy(), model.actuator_biasprm[i].copy()

        def fade(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            left = 1 - loss * (1 - np.exp(-data.time / time_constant))
            model.actuator_gainprm[i], model.actuator_biasprm[i] = gain * left, bias * left

        return fade

    return Part(Truth("motor_fade", actuator, "loss", None), force=start)


# --- the command on its way ---------------------------------------------------------------------------


def _those(model: mujoco.MjModel, actuator: str) -> list[int]:
    return [i for i in range(model.nu) if actuator in ("*", model.actuator(i).name)]


def _pointwise(actuator: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[mujoco.MjModel], Command]:
    def start(model: mujoco.MjModel) -> Command:
        which = _those(model, actuator)

        def transform(u: np.ndarray, time: float) -> np.ndarray:
            u = u.copy()
            u[which] = change(u[which])
            return u

        return transform

    return start


def command_gain(actuator: str, gain: float) -> Part:
    """The command arrives scaled."""
    return Part(Truth("actuator_gain", actuator, "gain", gain), command=_pointwise(actuator, lambda u: gain * u))


def command_bias(actuator: str, bias: float) -> Part:
    """The command arrives shifted."""
    return Part(Truth("actuator_bias", actuator, "bias", bias), command=_pointwise(actuator, lambda u: u + bias))


def command_limit(actuator: str, limit: float) -> Part:
    """The command arrives clipped."""
    truth = Truth("actuator_saturation", actuator, "limit", limit)
    return Part(truth, command=_pointwise(actuator, lambda u: np.clip(u, -limit, limit)))


def deadzone(actuator: str, width: float) -> Part:
    """Commands within plus and minus ``width`` do nothing; beyond, the width is lost: u - width · sign(u)."""
    lose = lambda u: np.sign(u) * np.maximum(np.abs(u) - width, 0.0)  # noqa: E731
    return Part(Truth("actuator_deadzone", actuator, "width", width), command=_pointwise(actuator, lose))


def command_curve(actuator: str, share: float, full: float) -> Part:
    """A share of what a command does goes with its square; nothing and a full one stay."""
    truth = Truth("actuator_curve", actuator, "share", share)
    return Part(truth, command=_pointwise(actuator, lambda u: u + share * (u * np.abs(u) / full - u)))


def command_delay(delay: float) -> Part:
    """All commands arrive late, s; before the first one arrives the actuators are commanded zero."""

    def start(model: mujoco.MjModel) -> Command:
        steps = round(delay / model.opt.timestep)
        assert abs(steps * model.opt.timestep - delay) < 1e-9, "a delay must be a multiple of the true time step"
        queue = deque([np.zeros(model.nu)] * steps)

        def transform(u: np.ndarray, time: float) -> np.ndarray:
            queue.append(u)
            return queue.popleft()

        return transform

    return Part(Truth("actuator_delay", "*", "delay", delay), command=start)


def command_lag(actuator: str, time_constant: float) -> Part:
    """A first-order filter, s, at rest at the start."""

    def start(model: mujoco.MjModel) -> Command:
        which, state = _those(model, actuator), np.zeros(model.nu)
        share = 1 - np.exp(-model.opt.timestep / time_constant)

        def transform(u: np.ndarray, time: float) -> np.ndarray:
            state[:] += share * (u - state)
            u = u.copy()
            u[which] = state[which]
            return u

        return transform

    return Part(Truth("actuator_lag", actuator, "time_constant", time_constant), command=start)


def hysteresis(actuator: str, half_width: float) -> Part:
    """A play operator on the command: what arrives follows only when pulled by more than ``half_width``."""

    def start(model: mujoco.MjModel) -> Command:
        which, state = _those(model, actuator), np.zeros(model.nu)

        def transform(u: np.ndarray, time: float) -> np.ndarray:
            state[:] = np.clip(state, u - half_width, u + half_width)
            u = u.copy()
            u[which] = state[which]
            return u

        return transform

    return Part(Truth("command_hysteresis", actuator, "width", None), command=start)


def dropout(actuator: str, after: float) -> Part:
    """A motor that dies ``after`` seconds into every episode."""

    def start(model: mujoco.MjModel) -> Command:
        which = _those(model, actuator)

        def transform(u: np.ndarray, time: float) -> np.ndarray:
            u = u.copy()
            if time >= after:
                u[which] = 0.0
            return u

        return transform

    return Part(Truth("motor_dropout", actuator, "after", None), command=start)


# --- the measurement ----------------------------------------------------------------------------------


def sensor_bias(joint: str, bias: float) -> Part:
    """An encoder whose zero is off, rad: it shows q + bias."""

    def start(model: mujoco.MjModel) -> Sensor:
        at = int(model.joint(joint).qposadr[0])

        def shift(qpos: np.ndarray, qvel: np.ndarray) -> None:
            qpos[at] += bias

        return shift

    return Part(Truth("sensor_bias", joint, "bias", bias), sensor=start)


def sensor_gain(joint: str, gain: float) -> Part:
    """An encoder with the wrong scale: it shows gain · q and gain · dq/dt."""

    def start(model: mujoco.MjModel) -> Sensor:
        at, dof = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])

        def scale(qpos: np.ndarray, qvel: np.ndarray) -> None:
            qpos[at] *= gain
            qvel[dof] *= gain

        return scale

    return Part(Truth("sensor_gain", joint, "gain", gain), sensor=start)


def sensor_delay(delay: float) -> Part:
    """All measurements show what was ``delay`` seconds ago (the start of the episode before that)."""
    return Part(Truth("sensor_delay", "*", "delay", delay), sensor_delay=delay)
