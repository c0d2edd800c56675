"""Small nominal models for the search for laws; the servo arm is that of ``benchmarks.undeclared``."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.undeclared.models import MODELS, Model, Noise, Start

FREE = '<geom contype="0" conaffinity="0"/>'
NOISE = Noise(5e-4, 1e-2)


def _pendulum() -> str:
    """A pendulum that hangs, with a motor on its axis."""
    return f"""<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <default>{FREE}</default>
  <worldbody>
    <body name="rod">
      <inertial pos="0 0 -0.25" mass="0.6" diaginertia="0.006 0.006 0.0003"/>
      <joint name="axis" axis="0 1 0" damping="0.05" armature="0.01"/>
      <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="0.3"/>
    </body>
  </worldbody>
  <actuator><motor name="axis" joint="axis" gear="2" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def _two_link() -> str:
    """Two links that hang, with a motor at the shoulder and one at the elbow."""
    return f"""<mujoco model="two links">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <default>{FREE}</default>
  <worldbody>
    <body name="upper">
      <inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0003"/>
      <joint name="shoulder" axis="0 1 0" damping="0.08" armature="0.02"/>
      <geom name="upper" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.3"/>
      <body name="lower" pos="0 0 -0.3">
        <inertial pos="0 0 -0.12" mass="0.4" diaginertia="0.002 0.002 0.0001"/>
        <joint name="elbow" axis="0 1 0" damping="0.04" armature="0.01"/>
        <geom name="lower" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" gear="4" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="elbow" joint="elbow" gear="1.5" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def _crane() -> str:
    """A cart-pole that hangs: a driven cart on a rail and a free pole below it."""
    return f"""<mujoco model="crane">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <default>{FREE}</default>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="1.5" diaginertia="0.01 0.01 0.01"/>
      <joint name="rail" type="slide" axis="1 0 0" damping="1.5"/>
      <geom name="cart" type="box" size="0.1 0.05 0.03" mass="1"/>
      <body name="pole">
        <inertial pos="0 0 -0.25" mass="0.4" diaginertia="0.005 0.005 0.0002"/>
        <joint name="pivot" axis="0 1 0" damping="0.005"/>
        <geom name="pole" type="capsule" size="0.015" fromto="0 0 0 0 0 -0.4" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="rail" joint="rail" gear="12" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def _hover() -> str:
    """A rotor on a vertical rod; the command is its lift beside the weight."""
    return f"""<mujoco model="hover">
  <option timestep="0.002"/>
  <default>{FREE}</default>
  <worldbody>
    <body name="rotor" gravcomp="1">
      <inertial pos="0 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/>
      <joint name="height" type="slide" axis="0 0 1" damping="0.4"/>
      <geom name="rotor" type="cylinder" size="0.1 0.01" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="height" joint="height" gear="3" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def _machine(
    build: Callable[[], str], amplitude: tuple[float, ...], start: Start,
    feedback: tuple[tuple[float, ...], ...] | None = None, fastest: float = 3.0,
) -> Model:  # fmt: skip
    return Model(
        build=build,
        frame_skip=5,
        episodes=8,
        steps=(150, 200),
        amplitude=amplitude,
        start=start,
        start_speed=0.3,
        noise=NOISE,
        feedback=feedback,
        fastest=fastest,
    )


LAW_MODELS: dict[str, Model] = {
    "pendulum": _machine(_pendulum, (0.9,), ((-0.8, 0.8),)),
    "two_link": _machine(_two_link, (0.8, 0.8), ((-0.5, 0.5), (-0.6, 0.6))),
    "crane": _machine(_crane, (0.9,), ((-0.2, 0.2), (-0.5, 0.5)), ((-0.3, 0.0, 0.0, 0.0),)),
    "hover": _machine(_hover, (0.7,), ((0.1, 0.4),), ((-1.2, -0.25),)),
}


def register_models() -> None:
    """Let the recorder of ``benchmarks.undeclared`` know these models."""
    MODELS.update(LAW_MODELS)
