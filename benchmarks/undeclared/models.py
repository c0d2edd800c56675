"""The nominal models: self-contained MJCF with every element named and every mass written out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import gymnasium
import mujoco
import numpy as np

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
Start = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Noise:
    """Additive Gaussian sensor noise.

    Attributes:
        qpos: standard deviation, rad or m.
        qvel: standard deviation, rad/s or m/s.
        correlation: of the noise from one control step to the next (AR(1)); 0 is white.
        quantum: positions are rounded to multiples of this after the noise, rad or m; 0 is none.
    """

    qpos: float
    qvel: float
    correlation: float = 0.0
    quantum: float = 0.0

    def times(self, factor: float) -> Noise:
        """The same law, louder."""
        return replace(self, qpos=self.qpos * factor, qvel=self.qvel * factor)


@dataclass(frozen=True)
class Model:
    """A nominal model and how it is excited.

    Attributes:
        build: makes the MJCF text.
        frame_skip: physics steps (of the nominal time step) per control step.
        episodes: how many are recorded.
        steps: control steps of an episode, (at least, at most).
        amplitude: of the commands, (nu,), within ctrlrange.
        start: lowest and highest initial position of each joint coordinate, (nq, 2).
        start_speed: initial velocities are uniform within plus and minus this, rad/s or m/s.
        noise: of its sensors, where a case does not say otherwise.
        feedback: (nu, nq + nv), added to the excitation as feedback @ measured state; None for open loop.
        fallen: coordinate and limit beyond which an episode ends.
        fastest: frequency in the excitation, Hz.
        falls: episodes of low excitation go without the feedback.
        spin: a free body is thrown with any orientation, and turns by up to this about each axis, rad/s.
    """

    build: Callable[[], str]
    frame_skip: int
    episodes: int
    steps: tuple[int, int]
    amplitude: tuple[float, ...]
    start: Start
    start_speed: float
    noise: Noise
    feedback: tuple[tuple[float, ...], ...] | None = None
    fallen: tuple[int, float] | None = None
    fastest: float = 6.0
    spin: float = 0.0
    falls: bool = True


@cache
def nominal_xml(name: str) -> str:
    """MJCF text of a nominal model; loads standalone."""
    return MODELS[name].build()


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _from_gymnasium(file: str) -> str:
    """A Gymnasium asset, as of :func:`_plain`."""
    return _plain(ET.parse(ASSETS / file).getroot())


def _quadruped() -> str:
    """dm_control's four-legged machine, as of :func:`_plain`: servos with filters of their own, three on each leg.

    Two of them pull at several joints, through tendons.
    """
    from dm_control.suite import quadruped  # opens a window's library, which warns where there is no window

    return _plain(ET.fromstring(quadruped.make_model(floor_size=10)))


def _plain(root: ET.Element) -> str:
    """A model with names for all elements, explicit geom masses, and no textures or settings in the way."""
    for tag in ("asset", "size", "include", "sensor"):
        for child in root.findall(tag):
            root.remove(child)
    if root.find("compiler") is None:
        root.insert(0, ET.Element("compiler"))
    compiler = root.find("compiler")
    total = compiler.get("settotalmass")
    for attribute in ("coordinate", "settotalmass", "inertiafromgeom"):  # the last one would overrule <inertial>
        compiler.attrib.pop(attribute, None)
    for parent in root.iter():
        for child in [c for c in parent if c.tag in ("light", "camera", "site")]:
            parent.remove(child)
        parent.attrib.pop("material", None)
    _name(root)
    compiled = mujoco.MjModel.from_xml_string(_text(root))
    if total is not None:
        mujoco.mj_setTotalmass(compiled, float(total))
    _write_masses(root, compiled)
    return _text(root)


def _name(root: ET.Element) -> None:
    for number, body in enumerate(root.iter("body"), 1):
        body.attrib.setdefault("name", f"body{number}")
        for i, geom in enumerate(body.findall("geom")):
            geom.attrib.setdefault("name", body.get("name") + (f"_{i}" if i else ""))
    for actuator in root.find("actuator"):
        actuator.attrib.setdefault("name", actuator.get("joint") or actuator.get("tendon"))
        actuator.attrib.setdefault("gear", "1")


def _volume(kind: int, size: np.ndarray) -> float:
    r, half = float(size[0]), float(size[1])
    ball = 4 / 3 * np.pi * r**3
    return {
        mujoco.mjtGeom.mjGEOM_SPHERE: ball,
        mujoco.mjtGeom.mjGEOM_CAPSULE: ball + 2 * np.pi * r**2 * half,
        mujoco.mjtGeom.mjGEOM_CYLINDER: 2 * np.pi * r**2 * half,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID: 4 / 3 * np.pi * np.prod(size),
    }[mujoco.mjtGeom(int(kind))]


def _write_masses(root: ET.Element, compiled: mujoco.MjModel) -> None:
    """Write each geom's share of its body's compiled mass; geoms come in the order of the compiled model."""
    for body in root.iter("body"):
        index = compiled.body(body.get("name")).id
        first, count = int(compiled.body_geomadr[index]), int(compiled.body_geomnum[index])
        shares = [_volume(compiled.geom_type[i], compiled.geom_size[i]) for i in range(first, first + count)]
        for geom, share in zip(body.findall("geom"), shares, strict=True):
            geom.attrib.pop("density", None)
            geom.set("mass", f"{compiled.body_mass[index] * share / sum(shares):.10g}")


def _servo_arm() -> str:
    """A small desk-top arm: yaw, shoulder and elbow under position servos, and a gripper welded to the forearm."""
    return """<mujoco model="servo arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="Euler"/>
  <default>
    <geom contype="0" conaffinity="0" rgba="0.8 0.6 0.3 1"/>
    <joint type="hinge"/>
  </default>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1"/>
    <body name="turret" pos="0 0 0.05">
      <inertial pos="0 0 0.03" mass="1.2" diaginertia="0.004 0.004 0.006"/>
      <joint name="yaw" axis="0 0 1" range="-2.6 2.6" limited="true" damping="0.3" frictionloss="0.05" armature="0.02"/>
      <geom name="turret" type="cylinder" size="0.06 0.04" pos="0 0 0.03"/>
      <body name="upper_arm" pos="0 0 0.08">
        <inertial pos="0 0 0.11" mass="0.45" diaginertia="0.0022 0.0022 0.0003"/>
        <joint name="shoulder" axis="0 1 0" range="-1.9 1.9" limited="true" damping="0.4" frictionloss="0.08"
               armature="0.025"/>
        <geom name="upper_arm" type="capsule" size="0.022" fromto="0 0 0 0 0 0.24"/>
        <body name="forearm" pos="0 0 0.24">
          <inertial pos="0 0 0.09" mass="0.3" diaginertia="0.0011 0.0011 0.00015"/>
          <joint name="elbow" axis="0 1 0" range="-2.4 2.4" limited="true" damping="0.2" frictionloss="0.04"
                 armature="0.012"/>
          <geom name="forearm" type="capsule" size="0.018" fromto="0 0 0 0 0 0.2"/>
          <body name="gripper" pos="0 0 0.21">
            <inertial pos="0 0 0.02" mass="0.12" diaginertia="0.00008 0.00008 0.00004"/>
            <geom name="gripper" type="box" size="0.02 0.03 0.03" pos="0 0 0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="yaw" joint="yaw" kp="4" kv="0.2" ctrllimited="true" ctrlrange="-2.2 2.2"/>
    <position name="shoulder" joint="shoulder" kp="7" kv="0.35" ctrllimited="true" ctrlrange="-1.6 1.6"/>
    <position name="elbow" joint="elbow" kp="3.5" kv="0.15" ctrllimited="true" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


def _thrown(name: str, geom: str, floor: str = 'condim="3"') -> Callable[[], str]:
    """A free body over a floor, without any actuator."""
    return lambda: (
        f"""<mujoco model="{name} toss">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" friction="0.6 0.005 0.0001" {floor}/>
    <body name="{name}" pos="0 0 0.5">
      <freejoint name="{name}"/>
      <geom name="{name}" friction="0.6 0.005 0.0001" {geom}/>
    </body>
  </worldbody>
</mujoco>
"""
    )


def _toss(build: Callable[[], str], height: tuple[float, float], noise: Noise) -> Model:
    """How free bodies are thrown: dropped from a height, or pushed over the floor and spun."""
    place = ((-0.2, 0.2), (-0.2, 0.2), height, *((0.0, 1.0),) * 4)
    return Model(build, 5, 16, (80, 110), (), place, 1.0, noise, spin=6.0)


def _desk_servo() -> str:
    """A hobby servo: a geared direct-current motor with a position loop of its own, which holds a weight."""
    return """<mujoco model="desk servo">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="lever" pos="0 0 0.4">
      <inertial pos="0.16 0 0" mass="0.32" diaginertia="0.0003 0.0012 0.0012"/>
      <joint name="shaft" axis="0 1 0" damping="0.08" frictionloss="0.06" armature="0.012"/>
      <geom name="lever" type="capsule" size="0.01" fromto="0 0 0 0.2 0 0" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <dcmotor name="servo" joint="shaft" input="pos" motorconst="1.4" resistance="5.5" controller="45 0 0 0 0 12"
             ctrllimited="true" ctrlrange="-1.8 1.8"/>
  </actuator>
</mujoco>
"""


def _dc_arm() -> str:
    """Two links in a vertical plane, each on a hobby servo."""
    return """<mujoco model="arm of hobby servos">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom type="capsule" size="0.012" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="upper" pos="0 0 0.5">
      <inertial pos="0 0 0.08" mass="0.22" diaginertia="0.0007 0.0007 0.00005"/>
      <joint name="hip" axis="0 1 0" damping="0.1" frictionloss="0.08" armature="0.015"/>
      <geom name="upper" fromto="0 0 0 0 0 0.15"/>
      <body name="lower" pos="0 0 0.15">
        <inertial pos="0 0 0.07" mass="0.16" diaginertia="0.0004 0.0004 0.00004"/>
        <joint name="knee" axis="0 1 0" damping="0.06" frictionloss="0.05" armature="0.01"/>
        <geom name="lower" fromto="0 0 0 0 0 0.13"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <dcmotor name="hip" joint="hip" input="pos" motorconst="1.5" resistance="5" controller="50 0 0 0 0 12"
             ctrllimited="true" ctrlrange="-1.6 1.6"/>
    <dcmotor name="knee" joint="knee" input="pos" motorconst="1.1" resistance="7" controller="50 0 0 0 0 12"
             ctrllimited="true" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


def _rotary_pendulum() -> str:
    """A motor turns an arm about a vertical axis; a pendulum hangs freely from the arm's end (Furuta 1992)."""
    return """<mujoco model="rotary pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="Euler"/>
  <default><geom type="capsule" size="0.006" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="arm" pos="0 0 0.3">
      <inertial pos="0.08 0 0" mass="0.095" diaginertia="0.00002 0.00023 0.00023"/>
      <joint name="arm" axis="0 0 1" damping="0.0015" armature="0.0003"/>
      <geom name="arm" fromto="0 0 0 0.16 0 0"/>
      <body name="pendulum" pos="0.16 0 0">
        <inertial pos="0 0 -0.09" mass="0.06" diaginertia="0.00018 0.00018 0.000005"/>
        <joint name="swing" axis="1 0 0" damping="0.0001"/>
        <geom name="pendulum" fromto="0 0 0 0 0 -0.18"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="arm" gear="0.04" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def _quadrotor() -> str:
    """Four rotors on an X, which push along the body's z and turn it the other way than they turn."""
    rotors = {"front_left": (0.12, 0.12, 1), "front_right": (0.12, -0.12, -1), "back_left": (-0.12, 0.12, -1),
              "back_right": (-0.12, -0.12, 1)}  # fmt: skip
    sites = "".join(f'<site name="{name}" pos="{x} {y} 0.02"/>' for name, (x, y, _) in rotors.items())
    motors = "".join(
        f'<motor name="{name}" site="{name}" gear="0 0 1 0 0 {-0.016 * turns}" ctrllimited="true" ctrlrange="0 6"/>'
        for name, (_, _, turns) in rotors.items()
    )
    return f"""<mujoco model="quadrotor">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="Euler" density="1.2" viscosity="1.8e-5"/>
  <worldbody>
    <body name="frame" pos="0 0 1">
      <freejoint name="frame"/>
      <inertial pos="0 0 0" mass="0.9" diaginertia="0.006 0.0065 0.011"/>
      <geom name="frame" type="box" size="0.08 0.05 0.03" contype="0" conaffinity="0"/>
      {sites}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""


def _hover() -> tuple[tuple[float, ...], ...]:
    """Feedback of a quadrotor near level: its turning, and a thrust that holds 1 m by w of the quaternion, about 1."""
    rows = []
    for x, y, turns in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        level = (0.9 * 9.81 / 4 + 1.0, -1.6 * y, 1.6 * x, 0.6 * turns)
        rows.append((0, 0, -1.0, *level, 0, 0, -0.8, -0.15 * y, 0.15 * x, 0.3 * turns))
    return tuple(rows)


MODELS: dict[str, Model] = {
    "inverted_pendulum": Model(
        build=lambda: _from_gymnasium("inverted_pendulum.xml"),
        frame_skip=2,
        episodes=16,
        steps=(50, 70),
        amplitude=(0.8,),
        start=((-0.2, 0.2), (-0.08, 0.08)),
        start_speed=0.1,
        noise=Noise(5e-4, 5e-3),
        feedback=((1.2, 7.5, 1.3, 1.2),),
        fallen=(1, 1.0),
    ),
    "half_cheetah": Model(
        build=lambda: _from_gymnasium("half_cheetah.xml"),
        frame_skip=5,
        episodes=12,
        steps=(80, 110),
        amplitude=(0.9,) * 6,
        start=((-0.1, 0.1), (0.0, 0.15), (-0.1, 0.1), *((-0.2, 0.2),) * 6),
        start_speed=0.2,
        noise=Noise(1e-3, 1e-2),
    ),
    "walker2d": Model(
        build=lambda: _from_gymnasium("walker2d_v5.xml"),
        frame_skip=4,
        episodes=14,
        steps=(90, 130),
        amplitude=(0.3, 0.25, 0.08) * 2,
        start=((-0.1, 0.1), (1.22, 1.3), (-0.1, 0.1), *((-0.7, -0.15), (-0.9, -0.2), (-0.3, 0.3)) * 2),
        start_speed=0.3,
        noise=Noise(5e-4, 1e-2),
    ),
    "reacher": Model(
        build=lambda: _from_gymnasium("reacher.xml"),
        frame_skip=2,
        episodes=10,
        steps=(100, 140),
        amplitude=(0.2, 0.2),
        start=((-0.5, 0.5), (-0.8, 0.8), (-0.1, 0.1), (-0.1, 0.1)),
        start_speed=0.0,
        noise=Noise(1e-3, 1e-2),
    ),
    "servo_arm": Model(
        build=_servo_arm,
        frame_skip=10,
        episodes=10,
        steps=(110, 150),
        amplitude=(1.0, 0.8, 1.0),
        fastest=3.0,
        start=((-0.5, 0.5),) * 3,
        start_speed=0.0,
        noise=Noise(1e-3, 1e-2),
    ),
    "hopper": Model(
        build=lambda: _from_gymnasium("hopper.xml"),
        frame_skip=4,
        episodes=14,
        steps=(90, 130),
        amplitude=(0.3, 0.3, 0.2),
        start=((-0.1, 0.1), (1.23, 1.3), (-0.1, 0.1), (-0.7, -0.15), (-0.9, -0.2), (-0.3, 0.3)),
        start_speed=0.3,
        noise=Noise(5e-4, 1e-2),
    ),
    "swimmer": Model(
        build=lambda: _from_gymnasium("swimmer.xml"),
        frame_skip=4,
        episodes=10,
        steps=(90, 130),
        amplitude=(0.8, 0.8),
        start=((-0.1, 0.1), (-0.1, 0.1), (-0.5, 0.5), (-0.6, 0.6), (-0.6, 0.6)),
        start_speed=0.1,
        noise=Noise(1e-3, 1e-2),
    ),
    "double_pendulum": Model(
        build=lambda: _from_gymnasium("inverted_double_pendulum.xml"),
        frame_skip=2,
        episodes=16,
        steps=(60, 90),
        amplitude=(0.15,),
        start=((-0.3, 0.3), (2.6, 3.6), (-0.5, 0.5)),
        start_speed=0.2,
        noise=Noise(5e-4, 5e-3),
    ),
    "pusher": Model(
        build=lambda: _from_gymnasium("pusher_v5.xml"),
        frame_skip=5,
        episodes=10,
        steps=(100, 140),
        amplitude=(1.6, 1.6, 1.0, 1.6, 0.6, 0.6, 0.4),
        fastest=3.0,
        start=(
            (-0.3, 0.3),
            (0.0, 0.6),
            (-0.3, 0.3),
            (-1.2, -0.4),
            (-0.3, 0.3),
            (-0.7, -0.3),
            (-0.3, 0.3),
            *((0, 0),) * 4,
        ),
        start_speed=0.0,
        noise=Noise(1e-3, 1e-2),
    ),
    "toss_cube": _toss(_thrown("cube", 'type="box" size="0.04 0.04 0.04" mass="0.12"'), (0.08, 0.5), Noise(5e-4, 1e-2)),
    "toss_ball": _toss(
        _thrown("ball", 'type="sphere" size="0.05" mass="0.02"', 'condim="6"'), (0.06, 0.6), Noise(5e-4, 1e-2)
    ),
    "desk_servo": Model(
        build=_desk_servo,
        frame_skip=10,
        episodes=10,
        steps=(110, 150),
        amplitude=(1.2,),
        fastest=3.0,
        start=((-0.6, 0.6),),
        start_speed=0.0,
        noise=Noise(1e-3, 1e-2),
    ),
    "toss_capsule": _toss(
        _thrown("rod", 'type="capsule" size="0.03 0.07" mass="0.25"', 'condim="4"'), (0.12, 0.5), Noise(5e-4, 1e-2)
    ),
    "dc_arm": Model(
        build=_dc_arm,
        frame_skip=10,
        episodes=10,
        steps=(110, 150),
        amplitude=(1.0, 1.3),
        fastest=3.0,
        start=((-0.6, 0.6),) * 2,
        start_speed=0.0,
        noise=Noise(1e-3, 1e-2),
    ),
    "ant": Model(
        build=lambda: _from_gymnasium("ant.xml"),
        frame_skip=5,
        episodes=14,
        steps=(60, 90),
        amplitude=(0.6,) * 8,
        fastest=3.0,
        start=(
            *((-0.1, 0.1),) * 2,
            (0.6, 0.75),
            (1.0, 1.0),
            *((0.0, 0.0),) * 3,
            *((-0.3, 0.3), (0.7, 1.0), (-0.3, 0.3), (-1.0, -0.7), (-0.3, 0.3), (-1.0, -0.7), (-0.3, 0.3), (0.7, 1.0)),
        ),
        start_speed=0.1,
        noise=Noise(5e-4, 1e-2),
    ),
    "humanoid": Model(
        build=lambda: _from_gymnasium("humanoid.xml"),
        frame_skip=5,
        episodes=14,
        steps=(60, 90),
        amplitude=(0.25,) * 17,
        fastest=3.0,
        start=(*((-0.1, 0.1),) * 2, (1.3, 1.4), (1.0, 1.0), *((0.0, 0.0),) * 3, *((-0.1, 0.1),) * 17),
        start_speed=0.1,
        noise=Noise(5e-4, 1e-2),
    ),
    "quadruped": Model(
        build=_quadruped,
        frame_skip=4,
        episodes=12,
        steps=(90, 120),
        amplitude=(0.5, 0.6, 0.5) * 4,
        fastest=3.0,
        start=(*((-0.1, 0.1),) * 2, (0.55, 0.6), (1.0, 1.0), *((0.0, 0.0),) * 3, *((-0.1, 0.1),) * 16),
        start_speed=0.1,
        noise=Noise(5e-4, 1e-2),
    ),
    "quadrotor": Model(
        build=_quadrotor,
        frame_skip=5,
        episodes=12,
        steps=(150, 200),
        amplitude=(0.5,) * 4,
        fastest=3.0,
        start=((0.0, 0.0), (0.0, 0.0), (0.9, 1.1), (1.0, 1.0), (-0.05, 0.05), (-0.05, 0.05), (-0.05, 0.05)),
        start_speed=0.2,
        noise=Noise(5e-4, 1e-2),
        feedback=_hover(),
        falls=False,
    ),
    "rotary_pendulum": Model(
        build=_rotary_pendulum,
        frame_skip=5,
        episodes=12,
        steps=(140, 200),
        amplitude=(0.7,),
        fastest=4.0,
        start=((-1.0, 1.0), (-0.8, 0.8)),
        start_speed=0.5,
        noise=Noise(1e-3, 1e-2),
    ),
}

UNSEEN = ("hopper", "swimmer", "double_pendulum", "pusher", "toss_capsule", "dc_arm", "rotary_pendulum")
"""Models that were added after the diagnosis was finished, or written with it and not run until its end."""
