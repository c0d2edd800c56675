"""Effects in words: phrases, units where they apply, sensible digits."""

from __future__ import annotations

import math
from collections.abc import Iterable

import mujoco

from idapt_pl.effects.base import ACTUATED, EFFECTS, names_in
from idapt_pl.effects.driven import joints_of_actuators


def phrase_at(effect: str, target: str) -> str:
    """``joint_frictionloss``, ``slider`` as "dry friction on joint slider"."""
    words = EFFECTS[effect].phrase if effect in EFFECTS else f"{effect.replace('_', ' ')} of"
    if target == "world":
        return words.removesuffix(" of")
    if target not in ("*", ACTUATED):
        return f"{words} {target}"
    before, _, kind = words.rpartition(" ")
    return f"{before} all {'actuated ' * (target == ACTUATED)}{'bodies' if kind == 'body' else kind + 's'}"


def format_number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits and no needless zeros."""
    if not math.isfinite(value):
        return "-"
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{float(f'{value:.{digits}g}'):g}"


def format_estimate(value: float | str, interval: Iterable[float] | None) -> tuple[str, str]:
    """A value with as many digits as its interval warrants, and the interval (empty if there is none)."""
    if isinstance(value, str):
        return value, ""
    if interval is None:
        return format_number(value), ""
    low, high = interval
    half = (high - low) / 2
    if value in (low, high):  # open: nobody knows how far it goes
        return format_number(value), f"{format_number(low)} to {format_number(high)}"
    if not (math.isfinite(half) and half > 1e-9 * abs(value)):
        return format_number(value), f"{format_number(low)} to {format_number(high)}"
    decimals = math.ceil(-math.log10(half / 2))
    if decimals > 6:
        return f"{value:.3g}", f"{low:.3g} to {high:.3g}"
    shown = [f"{round(v, decimals):.{max(decimals, 0)}f}" for v in (value, low, high)]
    return shown[0], f"{shown[1]} to {shown[2]}"


def unit_at(model: mujoco.MjModel, target: str, unit: str) -> str:
    """The unit of a joint's effect: "N·m or N" is the first for a hinge and the second for a slide."""
    if " or " not in unit:
        return unit
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    meant = {"*": set(range(model.njnt)), ACTUATED: joints_of_actuators(model)}.get(target, set())
    names = [model.joint(j).name for j in range(model.njnt)]
    joints = [j for j, name in enumerate(names) if j in meant or name in names_in(target, names)]
    kinds = {int(model.jnt_type[j]) for j in joints} & {slide, hinge}
    if len(kinds) != 1:
        return unit
    turning, straight = unit.split(" or ")
    return turning if hinge in kinds else straight


def listing(words: Iterable[str]) -> str:
    """As in "a, b or c", each once."""
    once = list(dict.fromkeys(words))
    return once[0] if len(once) == 1 else f"{', '.join(once[:-1])} or {once[-1]}"
