"""Forces that are put into the true world in every physics step, none of them in the library of effects.

Each function returns a :class:`~benchmarks.undeclared.hidden.Part`. Nothing here knows how a law is looked for.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from benchmarks.undeclared.hidden import Force, Part, Sensor, Truth

Law = Callable[[float, float, float, float], float]
"""Position, velocity, the actuator's force and time to a force on the joint."""


def on_joint(joint: str, law: Law) -> Part:
    """A force without memory."""

    def start(model: mujoco.MjModel) -> Force:
        q, v = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])

        def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            at = float(data.qpos[q]), float(data.qvel[v])
            data.qfrc_applied[v] += law(*at, float(motor_force(model, data)[v]), data.time)

        return act

    return Part(Truth("law", joint, "law", None), force=start)


def motor_force(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """What the actuators are about to do, (nv,): of this command, not of the last."""
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fwdActuation(model, data)
    return data.qfrc_actuator


def loaded_friction(joint: str, share: float, width: float) -> Part:
    """Dry friction in proportion to the weight that the joint carries."""

    def start(model: mujoco.MjModel) -> Force:
        v = int(model.joint(joint).dofadr[0])
        still = mujoco.MjData(model)

        def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            still.qpos[:] = data.qpos
            mujoco.mj_forward(model, still)
            data.qfrc_applied[v] -= share * abs(still.qfrc_bias[v]) * np.tanh(data.qvel[v] / width)

        return act

    return Part(Truth("law", joint, "law", None), force=start)


def bouc_wen(joint: str, force: float, width: float, sharpness: float = 1.0) -> Part:
    """Hysteresis: dz = (1 - |z|^n (sign(z v) + 1) / 2) v dt / width, force -F z (Bouc-Wen; n = 1 is close to Dahl)."""

    def start(model: mujoco.MjModel) -> Force:
        v = int(model.joint(joint).dofadr[0])
        z = 0.0

        def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            nonlocal z
            speed, h = float(data.qvel[v]), model.opt.timestep
            z += h * speed / width * (1 - abs(z) ** sharpness * (np.sign(z * speed) + 1) / 2)
            z = float(np.clip(z, -1, 1))
            data.qfrc_applied[v] -= force * z

        return act

    return Part(Truth("law", joint, "law", None), force=start)


def soft_shaft(joint: str, stiffness: float, damping: float, rotor: float) -> Part:
    """A rotor behind a torsion spring: the motor turns the rotor, and the spring the link."""

    def start(model: mujoco.MjModel) -> Force:
        q, v = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])
        angle: float | None = None
        speed = 0.0

        def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            nonlocal angle, speed
            motor, h = float(motor_force(model, data)[v]), model.opt.timestep
            angle = float(data.qpos[q]) if angle is None else angle
            shaft = stiffness * (angle - data.qpos[q]) + damping * (speed - data.qvel[v])
            speed += h * (motor - shaft) / rotor
            angle += h * speed
            data.qfrc_applied[v] += shaft - motor

        return act

    return Part(Truth("law", joint, "law", None), force=start)


def lagging_drag(joint: str, drag: float, time_constant: float) -> Part:
    """A drag that follows the speed late, as of grease that has to be set in motion: drag times low-passed velocity."""

    def start(model: mujoco.MjModel) -> Force:
        v = int(model.joint(joint).dofadr[0])
        slow = 0.0

        def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            nonlocal slow
            slow += model.opt.timestep / time_constant * (float(data.qvel[v]) - slow)
            data.qfrc_applied[v] -= drag * slow

        return act

    return Part(Truth("law", joint, "law", None), force=start)


def eccentric_encoder(joint: str, size: float, periods: int) -> Part:
    """An encoder whose disc sits off its axis: it shows q + size sin(n q), and its slope."""

    def start(model: mujoco.MjModel) -> Sensor:
        at, dof = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])

        def read(qpos: np.ndarray, qvel: np.ndarray) -> None:
            qvel[dof] *= 1 + size * periods * np.cos(periods * qpos[at])
            qpos[at] += size * np.sin(periods * qpos[at])

        return read

    return Part(Truth("law", joint, "law", None), sensor=start)
