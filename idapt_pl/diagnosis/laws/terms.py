"""The dictionary of terms that a law of force is put together from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.acting import actuators_on
from idapt_pl.effects.expression import COEFFICIENTS

WAVES = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 17.0, 20.0)
"""Periods of what repeats with the position, in a revolution (a hinge) or in 2π spreads (a slide)."""

FASTEST_WAVE = 60.0
"""Half-waves within the range of a joint beyond which samples do not show them."""


@dataclass(frozen=True)
class JointSizes:
    """What a joint does in the recordings.

    Attributes:
        name: of the joint.
        hinge: whether it turns.
        places: quantiles of its position, 5 % to 95 %, (7,).
        spread: from the first to the last of them.
        speed: rms of its velocity.
        episode: typical length of an episode, s.
        control: control period, s.
        command: ``"u"`` where the actuator is a plain motor, ``"motor"`` where it is not, empty where there is none.
    """

    name: str
    hinge: bool
    places: np.ndarray
    spread: float
    speed: float
    episode: float
    control: float
    command: str


@dataclass(frozen=True)
class Term:
    """One part of a law: amplitudes times functions of signals.

    Attributes:
        text: formula in which amplitudes are ``A``, ``B``, and inner parameters ``P``, ``R``.
        basis: signals that an amplitude is per, as in ``"q q v"`` for q²v; ``""`` for a plain force.
        inner: starting values of ``P``, ``R``.
        per: what their units are, as ``basis``; with ``/`` in front for its inverse.
    """

    text: str
    basis: str = ""
    inner: tuple[float, ...] = ()
    per: tuple[str, ...] = ()

    @property
    def amplitudes(self) -> int:
        """How many."""
        return 2 if "B" in self.text else 1

    @property
    def size(self) -> int:
        """Parameters in all."""
        return self.amplitudes + len(self.inner)

    def columns(self) -> list[str]:
        """The function that each amplitude is a factor of, as formulas."""
        text = self.with_inner([f"{value:.9g}" for value in self.inner])
        one = [(1, 0), (0, 1)][: self.amplitudes]
        return [text.replace("A", f"{a}").replace("B", f"{b}") for a, b in one]

    def with_inner(self, names: Sequence[str]) -> str:
        """The formula with names or numbers for the inner parameters."""
        text = self.text
        for letter, name in zip("PR", names, strict=False):
            text = text.replace(letter, f"({name})" if name.startswith("-") else name)
        return text

    def written(self, letters: Iterator[str]) -> str:
        """The formula with coefficients by the alphabet."""
        amplitudes = [next(letters) for _ in range(self.amplitudes)]
        text = self.with_inner([next(letters) for _ in self.inner])
        for letter, name in zip("AB", amplitudes, strict=False):
            text = text.replace(letter, name)
        return text


OF_THE_LIBRARY = frozenset({"A", "A*q", "A*v", "A*abs(v)*v", "A*tanh(v/P)", "A*u", "A*motor"})
"""Terms that alone are effects of the library: an offset, a spring, damping, drag, dry friction, a gain."""


def write_law(terms: Sequence[Term]) -> str:
    """The sum of some terms as one formula; coefficients by the alphabet, amplitudes of a term first."""
    letters = iter(COEFFICIENTS)
    return " + ".join(t.written(letters) for t in terms)


def joint_sizes(
    model: mujoco.MjModel, joint: int, qpos: np.ndarray, qvel: np.ndarray, episode: float, control: float
) -> JointSizes:
    """What a joint does, from all samples of its position and velocity, (n,) each."""
    places = np.quantile(qpos, [0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95])
    on = actuators_on(model, joint)
    plain = [
        model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
        for i in on
    ]
    command = ("u" if len(on) == 1 and plain[0] else "motor") if on else ""
    speed = float(np.sqrt(np.square(qvel).mean())) + 1e-9
    hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    spread = float(places[-1] - places[0]) + 1e-9
    return JointSizes(model.joint(joint).name, bool(hinge), places, spread, speed, episode, control, command)


def dictionary(s: JointSizes) -> list[Term]:
    """All terms for a joint, the plain ones first."""
    terms = [*of_position(s), *of_speed(s), *of_both(s), *of_load(s), *of_memory(s)]
    terms += [Term("A*exp(-t/P)", "", (tau,), ("t",)) for tau in decays(s)]
    if s.command:
        terms += of_command(s, s.command)
    if s.command == "motor":
        terms += [Term("A*u", "u"), Term("A*lowpass(u, P)", "u", (0.1,), ("t",))]
    return terms


def waves(s: JointSizes) -> list[float]:
    """Wave numbers that the recordings can show."""
    unit = 1.0 if s.hinge else 2 * np.pi / s.spread
    return [k * unit for k in WAVES if 0.5 < k * unit * s.spread / np.pi < FASTEST_WAVE]


def decays(s: JointSizes) -> list[float]:
    """Time constants of what fades within an episode, s."""
    return [0.15 * s.episode, 0.4 * s.episode, s.episode]


def signs(s: JointSizes) -> list[float]:
    """Speeds at which the smooth sign of a velocity turns over."""
    return [0.03 * s.speed, 0.1 * s.speed, 0.4 * s.speed]


def of_position(s: JointSizes) -> list[Term]:
    """Springs, stops, detents and what repeats."""
    terms = [Term("A"), Term("A*q", "q"), Term("A*q**2", "q q"), Term("A*q**3", "q q q")]
    for place in s.places[1:-1]:
        terms.append(Term("A*positive(q - P)", "q", (float(place),), ("q",)))
        terms.append(Term("A*positive(P - q)", "q", (float(place),), ("q",)))
    for place in s.places:
        for width in (0.06, 0.15):
            inner = (float(place), width * s.spread)
            terms.append(Term("A*(q - P)*exp(-((q - P)/R)**2)", "q", inner, ("q", "q")))
    terms += [Term("A*sin(P*q) + B*cos(P*q)", "", (k,), ("/q",)) for k in waves(s)]
    terms += [Term("A*exp(-q/P)", "", (f * s.spread,), ("q",)) for f in (0.3, -0.3)]
    return terms


def of_speed(s: JointSizes) -> list[Term]:
    """Friction of many shapes."""
    terms = [Term("A*v", "v"), Term("A*abs(v)", "v"), Term("A*abs(v)*v", "v v"), Term("A*v**3", "v v v")]
    terms += [Term("A*tanh(v/P)", "", (b,), ("v",)) for b in signs(s)]
    terms += [Term("A*positive(tanh(v/P))", "", (0.1 * s.speed,), ("v",))]
    terms += [Term("A*tanh(v/P)*exp(-(v/R)**2)", "", (0.1 * s.speed, f * s.speed), ("v", "v")) for f in (0.5, 1.5)]
    terms += [Term("A*positive(abs(v) - P)*sign(v)", "v", (f * s.speed,), ("v",)) for f in (0.5, 1.0, 1.6)]
    return terms


def of_both(s: JointSizes) -> list[Term]:
    """Friction that depends on where the joint is, or on time."""
    terms = [Term("A*q*v", "q v"), Term("A*q**2*v", "q q v")]
    terms += [Term("(A*sin(P*q) + B*cos(P*q))*v", "v", (k,), ("/q",)) for k in waves(s)[:8]]
    terms += [Term("A*exp(-q/P)*v", "v", (f * s.spread,), ("q",)) for f in (0.3, -0.3)]
    for b in signs(s)[1:]:
        terms.append(Term("A*q*tanh(v/P)", "q", (b,), ("v",)))
        terms.append(Term("A*q**2*tanh(v/P)", "q q", (b,), ("v",)))
        terms.append(Term("A*exp(-t/P)*tanh(v/R)", "", (0.4 * s.episode, b), ("t", "v")))
        terms += [Term("A*exp(-q/P)*tanh(v/R)", "", (f * s.spread, b), ("q", "v")) for f in (0.3, -0.3)]
    terms += [Term("A*exp(-t/P)*v", "v", (tau,), ("t",)) for tau in decays(s)]
    return terms


def of_load(s: JointSizes) -> list[Term]:
    """Friction that grows with what the joint carries."""
    terms = [Term("A*load", "load")]
    for b in signs(s):
        terms.append(Term("A*abs(load)*tanh(v/P)", "load", (b,), ("v",)))
        if s.command:
            terms.append(Term(f"A*abs({s.command})*tanh(v/P)", s.command, (b,), ("v",)))
    return terms


def of_command(s: JointSizes, u: str) -> list[Term]:
    """What a motor or its driver gets wrong; ``u`` is the signal that stands for its torque."""
    terms = [Term(f"A*{u}", u), Term(f"A*abs({u})", u), Term(f"A*abs({u})*{u}", f"{u} {u}")]
    terms += [Term(f"A*{u}**3", f"{u} {u} {u}"), Term(f"A*{u}*abs(v)", f"{u} v"), Term(f"A*{u}*v", f"{u} v")]
    terms += [Term(f"A*{u}*v**2", f"{u} v v"), Term(f"A*{u}*q", f"{u} q"), Term(f"A*{u}*q**2", f"{u} q q")]
    terms += [Term(f"A*{u}*positive(abs(v) - P)", f"{u} v", (s.speed,), ("v",))]
    terms += [Term(f"A*{u}*exp(-t/P)", u, (tau,), ("t",)) for tau in decays(s)]
    terms += [Term(f"(A*sin(P*q) + B*cos(P*q))*{u}", u, (k,), ("/q",)) for k in waves(s)]
    terms += [Term(f"A*{u}*exp(-q/P)", u, (f * s.spread,), ("q",)) for f in (0.3, -0.3)]
    if u == "u":
        terms += [Term("A*lowpass(u, P)", "u", (tau,), ("t",)) for tau in (0.03, 0.1, 0.3)]
        terms += [Term("A*u*lowpass(u**2, P)", "u u u", (tau,), ("t",)) for tau in decays(s)[:2]]
    return terms


def of_memory(s: JointSizes) -> list[Term]:
    """Hysteresis, and drag that comes late."""
    terms = [Term("A*hysteresis(P)", "", (f * s.spread,), ("q",)) for f in (0.01, 0.03, 0.08, 0.2, 0.4)]
    terms += [Term("A*lowpass(v, P)", "v", (tau,), ("t",)) for tau in (0.05, 0.15, 0.5)]
    return terms


# --- units --------------------------------------------------------------------------------------------------


def term_units(term: Term, hinge: bool) -> list[str]:
    """Units of the amplitudes, then of the inner parameters."""
    force = "N·m" if hinge else "N"
    amplitude = write_unit({force: 1}, term.basis, hinge, invert=True)
    inner = [write_unit({}, p.removeprefix("/"), hinge, invert=p.startswith("/")) for p in term.per]
    return [amplitude] * term.amplitudes + inner


def write_unit(start: dict[str, int], signals: str, hinge: bool, invert: bool) -> str:
    """A unit times (or, inverted, over) the units of some signals, such as ``N·m·s/rad``; ``1`` for a plain number."""
    angle, force = ("rad", "N·m") if hinge else ("m", "N")
    of = {
        "q": {angle: 1}, "v": {angle: 1, "s": -1}, "u": {"command": 1}, "t": {"s": 1}, "motor": {force: 1},
        "load": {force: 1},
    }  # fmt: skip
    powers = dict(start)
    for signal in signals.split():
        for unit, power in of[signal].items():
            powers[unit] = powers.get(unit, 0) + (-power if invert else power)
    raised = {1: "", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶"}
    power_of = lambda u, p: f"({u}){raised[p]}" if p > 1 and "·" in u else u + raised[p]  # noqa: E731
    above = "·".join(power_of(u, p) for u, p in powers.items() if p > 0)
    below = "·".join(power_of(u, -p) for u, p in powers.items() if p < 0)
    if not below:
        return above or "1"
    several = sum(p < 0 for p in powers.values()) > 1 or "N·m" in (u for u, p in powers.items() if p == -1)
    return f"{above or '1'}/({below})" if several else f"{above or '1'}/{below}"
