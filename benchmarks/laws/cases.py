"""The cases: which law is planted where, on which joint it acts, and on what it depends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.laws import planted
from benchmarks.laws.models import LAW_MODELS
from benchmarks.laws.planted import on_joint
from benchmarks.undeclared import hidden
from benchmarks.undeclared.cases import FINE, RK4, Case, Numerics
from benchmarks.undeclared.hidden import Part
from benchmarks.undeclared.models import MODELS

HISTORY = frozenset({"history"})


@dataclass(frozen=True)
class PlantedLaw:
    """What was planted, and which answers are right.

    Attributes:
        case: how it is recorded.
        joint: where it acts; empty for a control.
        depends: sets of variables that name it rightly: of q, v, u, load, t, history (u: command or motor force).
        tuned: whether the search for laws was developed with it in sight (seed 0).
        kind: ``law``, ``sensor`` (no law of force is right), ``nothing`` or ``library`` (an effect of the library).
    """

    case: Case
    joint: str
    depends: tuple[frozenset[str], ...]
    tuned: bool
    kind: str


PLANTED: dict[str, PlantedLaw] = {}


def _add(
    name: str, model: str, joint: str, depends: str, part: Part | None, tuned: bool, kind: str = "law",
    numerics: Numerics = FINE,
) -> None:  # fmt: skip
    """Register a case; ``depends`` are alternatives such as ``"q v | v load"``."""
    parts = () if part is None else (part,)
    truth = tuple(p.truth for p in parts)
    case = Case(name, model, truth, "outside", (), parts, numerics, {**MODELS, **LAW_MODELS}[model].noise)
    sets = tuple(frozenset(words.split()) for words in depends.split("|")) if depends else ()
    PLANTED[name] = PlantedLaw(case, joint, sets, tuned, kind)


def _smooth_sign(v: float, width: float = 0.02) -> float:
    return float(np.tanh(v / width))


def _detent(q: float, middle: float, width: float) -> float:
    return -(q - middle) / width * float(np.exp(-(((q - middle) / width) ** 2)))


# --- half of the laws: the search was developed on their seed 0 -------------------------------------------

_add("pendulum_loaded_friction", "pendulum", "axis", "v load | q v | q v load",
     planted.loaded_friction("axis", 0.35, 0.03), True)  # fmt: skip
_add("pendulum_ripple", "pendulum", "axis", "q u",
     on_joint("axis", lambda q, v, f, t: 0.25 * f * np.sin(7 * q)), True)  # fmt: skip
_add("pendulum_detent", "pendulum", "axis", "q",
     on_joint("axis", lambda q, v, f, t: 0.8 * _detent(q, 0.4, 0.15)), True, numerics=RK4)  # fmt: skip
_add("pendulum_thermal_fade", "pendulum", "axis", "u t",
     on_joint("axis", lambda q, v, f, t: -0.6 * f * (1 - np.exp(-t / 0.7))), True)  # fmt: skip
_add("pendulum_angle_damping", "pendulum", "axis", "q v",
     on_joint("axis", lambda q, v, f, t: -0.15 * (1 + np.sin(2 * q)) * v), True)  # fmt: skip
_add("link_hysteresis", "two_link", "elbow", "history",
     planted.bouc_wen("elbow", 0.25, 0.15), True)  # fmt: skip
_add("link_saturation", "two_link", "elbow", "u",
     on_joint("elbow", lambda q, v, f, t: -0.35 * f * abs(f)), True, numerics=RK4)  # fmt: skip
_add("link_torque_loss", "two_link", "shoulder", "u v",
     on_joint("shoulder", lambda q, v, f, t: -0.12 * f * abs(v)), True)  # fmt: skip
_add("link_one_sided_spring", "two_link", "elbow", "q",
     on_joint("elbow", lambda q, v, f, t: -4.0 * max(q - 0.5, 0.0)), True)  # fmt: skip
_add("servo_cable_drag", "servo_arm", "shoulder", "q v",
     on_joint("shoulder", lambda q, v, f, t: -(0.1 + 1.2 * q * q) * _smooth_sign(v, 0.1)), True)  # fmt: skip
_add("crane_lopsided_friction", "crane", "rail", "v",
     on_joint("rail", lambda q, v, f, t: -1.5 * _smooth_sign(v) if v < 0 else -4.0 * v), True)  # fmt: skip
_add("crane_screw", "crane", "rail", "q",
     on_joint("rail", lambda q, v, f, t: 2.0 * np.sin(40 * q)), True)  # fmt: skip
_add("hover_ground_effect", "hover", "height", "q u | q",
     on_joint("height", lambda q, v, f, t: (4.9 + f) * 0.25 * np.exp(-q / 0.12)), True)  # fmt: skip
_add("link_slow_grease", "two_link", "shoulder", "history",
     planted.lagging_drag("shoulder", 0.5, 0.15), True)  # fmt: skip

# --- the other half: held back until the end ----------------------------------------------------------------

_add("link_loaded_friction", "two_link", "shoulder", "v load | q v | q v load",
     planted.loaded_friction("shoulder", 0.25, 0.03), False)  # fmt: skip
_add("pendulum_hysteresis", "pendulum", "axis", "history",
     planted.bouc_wen("axis", 0.3, 0.1, 2.0), False)  # fmt: skip
_add("pendulum_lopsided_damping", "pendulum", "axis", "v",
     on_joint("axis", lambda q, v, f, t: -0.25 * v if v > 0 else -0.02 * v), False)  # fmt: skip
_add("pendulum_cubic_spring", "pendulum", "axis", "q",
     on_joint("axis", lambda q, v, f, t: -0.7 * q**3), False, numerics=RK4)  # fmt: skip
_add("pendulum_clutch", "pendulum", "axis", "v",
     on_joint("axis", lambda q, v, f, t: -0.4 * max(abs(v) - 2.0, 0.0) * np.sign(v)), False)  # fmt: skip
_add("link_other_stribeck", "two_link", "elbow", "v",
     on_joint("elbow", lambda q, v, f, t: -(0.06 + 0.16 / (1 + (v / 0.5) ** 2)) * _smooth_sign(v, 0.05)),
     False)  # fmt: skip
_add("link_ripple", "two_link", "shoulder", "q u",
     on_joint("shoulder", lambda q, v, f, t: 0.2 * f * np.cos(9 * q)), False)  # fmt: skip
_add("link_soft_shaft", "two_link", "elbow", "history",
     planted.soft_shaft("elbow", 25.0, 0.05, 0.01), False)  # fmt: skip
_add("servo_thermal_fade", "servo_arm", "elbow", "u t",
     on_joint("elbow", lambda q, v, f, t: -0.6 * f * (1 - np.exp(-t / 0.9))), False)  # fmt: skip
_add("servo_detent", "servo_arm", "yaw", "q",
     on_joint("yaw", lambda q, v, f, t: 0.7 * _detent(q, -0.3, 0.12)), False)  # fmt: skip
_add("servo_angle_damping", "servo_arm", "yaw", "q v",
     on_joint("yaw", lambda q, v, f, t: -0.4 * (1 + np.sin(2 * q)) * v), False)  # fmt: skip
_add("crane_cubic_drag", "crane", "pivot", "v",
     on_joint("pivot", lambda q, v, f, t: -0.01 * v**3), False)  # fmt: skip
_add("crane_torque_loss", "crane", "rail", "u v",
     on_joint("rail", lambda q, v, f, t: -0.4 * f * abs(v)), False)  # fmt: skip
_add("crane_cable_drag", "crane", "rail", "q v",
     on_joint("rail", lambda q, v, f, t: -6.0 * np.exp(-(q + 0.3) / 0.3) * v), False)  # fmt: skip

# --- no law of force is right ------------------------------------------------------------------------------

_add("pendulum_encoder", "pendulum", "axis", "", planted.eccentric_encoder("axis", 0.03, 2), True, "sensor")
_add("link_encoder", "two_link", "elbow", "", planted.eccentric_encoder("elbow", 0.03, 3), False, "sensor")

# --- controls: nothing, and effects of the library --------------------------------------------------------------

for _model in ("pendulum", "two_link", "crane", "hover", "servo_arm"):
    _add(f"{_model}_nothing", _model, "", "", None, _model in ("pendulum", "two_link"), "nothing")
_add("pendulum_dry_friction", "pendulum", "", "", hidden.joint_frictionloss("axis", 0.15), True, "library")
_add("two_link_damping", "two_link", "", "", hidden.joint_damping("elbow", 0.15), True, "library")
_add("two_link_gain", "two_link", "", "", hidden.motor_gain("shoulder", 0.7), False, "library")
_add("crane_pole_mass", "crane", "", "", hidden.body_mass("pole", 0.7), False, "library")
_add("servo_dry_friction", "servo_arm", "", "", hidden.joint_frictionloss("elbow", 0.4), False, "library")
