"""A diagnosis in words: the verdict as sentences, effects as a person would call them, sensible digits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from idapt_pl.domains.effects import ACTUATED

MEANINGS = {
    "body_mass": "mass of body",
    "body_inertia": "mass, centre and inertia of body",
    "body_com": "centre of mass of body",
    "payload": "a load on body",
    "joint_damping": "viscous friction (damping) on joint",
    "joint_frictionloss": "dry friction on joint",
    "joint_stribeck": "friction that falls with speed (Stribeck) on joint",
    "joint_armature": "rotor inertia (armature) on joint",
    "joint_stiffness": "a spring on joint",
    "joint_springref": "rest position of the spring on joint",
    "joint_backlash": "backlash in joint",
    "joint_cogging": "cogging in joint",
    "joint_drag": "quadratic drag on joint",
    "actuator_gain": "gain of actuator",
    "actuator_bias": "offset of the commands to actuator",
    "actuator_delay": "delay of actuator",
    "actuator_lag": "first-order lag of actuator",
    "actuator_deadzone": "dead zone of actuator",
    "actuator_saturation": "saturation of actuator",
    "actuator_rotation": "rotation of the commands to actuator",
    "actuator_kp": "stiffness of servo",
    "actuator_kv": "velocity feedback of actuator",
    "motor_constant": "torque constant of motor",
    "contact_friction": "contact friction of geom",
    "contact_softness": "contact softness of geom",
    "fluid_drag": "drag of the surrounding medium",
    "gravity_direction": "direction of gravity",
    "external_force": "a constant force on body",
    "sensor_bias": "offset of the position sensor of joint",
    "sensor_gain": "scale of the sensors of joint",
    "sensor_delay": "delay of the sensors of joint",
    "numerics": "time step and integrator of the simulation",
}
"""What each effect is called in a sentence; its target follows, unless that is the world."""

HEADLINES = {
    "effects_found": "Found what the model lacks",
    "no_missing_effect": "Nothing is missing",
    "unexplained_residual": "Something is missing that no known effect explains",
    "insufficient_excitation": "These recordings cannot tell",
}


def meaning(effect: str, target: str) -> str:
    """``joint_frictionloss``, ``slider`` as "dry friction on joint slider"."""
    words = MEANINGS.get(effect, effect.replace("_", " ") + " of")
    if target == "world":
        return words.removesuffix(" of")
    if target not in ("*", ACTUATED):
        return f"{words} {target}"
    before, _, kind = words.rpartition(" ")
    return f"{before} all {'actuated ' * (target == ACTUATED)}{'bodies' if kind == 'body' else kind + 's'}"


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits and no needless zeros."""
    if not math.isfinite(value):
        return "-"
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{float(f'{value:.{digits}g}'):g}"


def estimate(value: float | str, interval: Iterable[float] | None) -> tuple[str, str]:
    """A value with as many digits as its interval warrants, and the interval (empty if there is none)."""
    if isinstance(value, str):
        return value, ""
    if interval is None:
        return number(value), ""
    low, high = interval
    half = (high - low) / 2
    if not (math.isfinite(half) and half > 1e-9 * abs(value)):
        return number(value), f"{number(low)} to {number(high)}"
    decimals = math.ceil(-math.log10(half / 2))
    if decimals > 6:
        return tuple(f"{value:.3g} | {low:.3g} to {high:.3g}".split(" | "))
    shown = [f"{round(v, decimals):.{max(decimals, 0)}f}" for v in (value, low, high)]
    return shown[0], f"{shown[1]} to {shown[2]}"


def unit_at(model: mujoco.MjModel, target: str, unit: str) -> str:
    """The unit of a joint's effect: "N·m or N" is the first for a hinge and the second for a slide."""
    if " or " not in unit:
        return unit
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    driven = set(model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0])
    meant = {"*": set(range(model.njnt)), ACTUATED: driven}.get(target, set())
    joints = [j for j in range(model.njnt) if j in meant or model.joint(j).name == target]
    kinds = {int(model.jnt_type[j]) for j in joints} & {slide, hinge}
    if len(kinds) != 1:
        return unit
    turning, straight = unit.split(" or ")
    return turning if hinge in kinds else straight


def in_words(effect: dict, model: mujoco.MjModel) -> str:
    """One effect of the report: what, where, how much, and how surely."""
    parts, several = [], len(effect["parameters"]) > 1
    for name, p in effect["parameters"].items():
        value, interval = estimate(p["estimate"], p["ci95"])
        unit = unit_at(model, effect["target"], p["unit"])
        words = f"{name} {value}" if several else value
        words += f" {unit}" if unit not in ("", "1") else ""
        words += f" (95 %: {interval})" if interval else ""
        if p["nominal"] not in (0, 0.0, p["estimate"]):
            shown = p["nominal"] if isinstance(p["nominal"], str) else number(p["nominal"])
            words += f" instead of {shown}"
        parts.append(words)
    return f"{meaning(effect['effect'], effect['target'])}, {', '.join(parts)}"


def headline(report: dict) -> str:
    """The verdict in a few words."""
    if report["verdict"] == "unexplained_residual" and report["effects"]:
        return "Something is still missing that no known effect explains"
    return HEADLINES[report["verdict"]]


def verdict_in_words(report: dict, model: mujoco.MjModel) -> list[str]:
    """The verdict as sentences, the most important first."""
    makers = {
        "effects_found": found,
        "no_missing_effect": nothing_missing,
        "unexplained_residual": unexplained,
        "insufficient_excitation": too_quiet,
    }
    return [*makers[report["verdict"]](report, model), *undecided(report)]


def found(report: dict, model: mujoco.MjModel) -> list[str]:
    """What the model lacks, and what adding it gains."""
    return [lacking(report, model), gain(report["error"], "it" if len(report["effects"]) == 1 else "them")]


def lacking(report: dict, model: mujoco.MjModel) -> str:
    """What was found, as a sentence."""
    effects = report["effects"]
    listed = "; ".join(in_words(e, model) for e in effects)
    new = all(p["nominal"] == 0 for e in effects for p in e["parameters"].values())
    what = ("effect" if new else "change") + "s" * (len(effects) > 1)
    how_many = "one" if len(effects) == 1 else str(len(effects))
    return f"The model {'lacks' if new else 'needs'} {how_many} {what}: {listed}."


def gain(error: dict, them: str) -> str:
    """What adding the effects does to the held-out error."""
    share = error["removed_share"]
    removes = f"removes {100 * share:.0f} % of the removable error" if share > 0 else "changes the error"
    return (
        f"Adding {them} {removes} on episodes not used for fitting: from {number(error['before'])} "
        f"to {number(error['after'])} times the measurement noise."
    )


def nothing_missing(report: dict, model: mujoco.MjModel) -> list[str]:
    """That the model is as good as the data can show."""
    level = report["error"]["after"]
    sentences = [
        "No missing effect: none of the effects tried makes the predictions of episodes not used for fitting "
        "better than chance would."
    ]
    if level < 1.3:
        return [*sentences, f"The error is {number(level)} times the measurement noise; 1 is as good as can be."]
    return [
        *sentences,
        f"The error is {number(level)} times the measurement noise, but neither state nor commands predict the rest.",
    ]


def unexplained(report: dict, model: mujoco.MjModel) -> list[str]:
    """What was found all the same, and that it does not suffice."""
    error = report["error"]
    level = f"{number(error['after'])} times the measurement noise"
    if not report["effects"]:
        return [
            f"The model lacks something, and no effect of the library explains it: the error is {level} on episodes "
            "not used for fitting."
        ]
    helps = "; ".join(in_words(e, model) for e in report["effects"])
    return [
        f"Part of the error stays unexplained: {level} on episodes not used for fitting is left after all that helps.",
        f"What helps: {helps}.",
        gain(error, "it" if len(report["effects"]) == 1 else "them"),
    ]


def too_quiet(report: dict, model: mujoco.MjModel) -> list[str]:
    """That the recordings would not have shown an effect."""
    return [
        "These recordings cannot tell whether something is missing: they move the mechanism so little that even a "
        "strong effect would hide in the measurement noise."
    ]


def undecided(report: dict) -> list[str]:
    """Which effects are one of several that explain the data equally well."""
    sentences = []
    for e in report["effects"]:
        own = meaning(e["effect"], e["target"])
        others = [meaning(q["effect"], q["target"]) for q in e.get("equivalent", ())]
        if others:
            others = ["another form of it" if o == own else o for o in others]
            sentences.append(f"These data cannot tell {own} from {listing(others)}.")
    return sentences


def listing(words: Iterable[str]) -> str:
    """As in "a, b or c", each once."""
    once = list(dict.fromkeys(words))
    return once[0] if len(once) == 1 else f"{', '.join(once[:-1])} or {once[-1]}"


def error_rows(report: dict) -> list[tuple[str, float, str]]:
    """The table before, after, floor, ceiling: name, value, what it means."""
    error = report["error"]
    given = "the model as it was given" + (", with the effects declared" if report["declared"] else "")
    return [
        ("before", error["before"], given),
        ("after", error["after"], "with the effects below" if report["effects"] else "the same: nothing was added"),
        ("noise floor", error["noise_floor"], "a perfect model: what the measurement noise alone leaves"),
        ("ceiling", error["ceiling"], "the given model, corrected by a black box (a regression on state and commands)"),
    ]


def episodes(numbers: Sequence[int], most: int = 12) -> str:
    """As in "episodes 0, 1, 2", or how many there are where they are more than anyone reads."""
    if len(numbers) > most:
        return f"{len(numbers)} episodes"
    return f"episode{'s' * (len(numbers) != 1)} {', '.join(map(str, numbers))}"


def worst_channels(per_channel: dict[str, dict], most: int = 4) -> list[str]:
    """The 2 to ``most`` channels with the largest error relative to noise, in the model's order."""
    ratio = np.array([c["before"] / max(c["noise"], 1e-12) for c in per_channel.values()])
    keep = np.argsort(-ratio)[:most]
    names = list(per_channel)
    return [names[i] for i in np.sort(keep[(ratio[keep] > 0.1 * ratio.max()) | (np.arange(len(keep)) < 2)])]
