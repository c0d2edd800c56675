"""Forces that were learned from recordings: a law as a formula, and a small network where no law was found."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import find_joints, parameter
from idapt_pl.effects.expression import COEFFICIENTS, SIGNALS, Expression, parse_expression
from idapt_pl.effects.runtime import ForceEffect

JointSignals = Mapping[str, np.ndarray]
"""JointSignals of a joint by name (:data:`~idapt_pl.effects.expression.SIGNALS`), (n,) each."""


TURNING_FREELY = (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
"""Joints without a single angle or velocity that a law could look at."""


def acts_otherwise(spec: mujoco.MjSpec) -> bool:
    """Whether an actuator of a model pulls at a tendon or the like, and so perhaps at joints that it does not name."""
    return any(a.trntype != mujoco.mjtTrn.mjTRN_JOINT for a in spec.actuators)


@dataclass(frozen=True)
class SignalForce(ForceEffect):
    """A force that may depend on commands, loads, time and what was before, beside position and velocity."""

    @property
    @abstractmethod
    def signals(self) -> frozenset[str]:
        """What it depends on."""

    @property
    def memories(self) -> int:
        """Number of states that it remembers by; all are 0 when an episode begins."""
        return 0

    @abstractmethod
    def force_from(self, signals: JointSignals, memory: np.ndarray) -> np.ndarray:
        """Force on the joint, (n,); ``memory``: (n, memories)."""

    def remember(
        self, before: JointSignals, now: JointSignals, memory: np.ndarray, seconds: float | np.ndarray
    ) -> np.ndarray:
        """The memory after signals went from one value to the next in so many seconds, (n, memories)."""
        return memory

    def apply(self, spec: mujoco.MjSpec) -> None:
        joints = [j for j in find_joints(spec, self.target) if j.type not in TURNING_FREELY]
        if not joints:
            raise ValueError(
                f"{self.name} on {self.target!r}: a law needs a hinge or a slide, not a free or ball joint"
            )
        driven = {a.target for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT}
        idle = [j.name for j in joints if j.name not in driven]
        of_motor = self.signals & ({"u"} if acts_otherwise(spec) else {"u", "motor"})
        if idle and of_motor:
            what = " and ".join(sorted(of_motor))
            raise ValueError(
                f"{self.name} on {self.target!r} depends on {what}, but no actuator acts on joint {idle[0]!r}"
            )

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        raise TypeError(f"{self.name} needs more than positions and velocities: use force_from")


@dataclass(frozen=True)
class LearnedForce(SignalForce):
    """A force law in words of a formula, such as ``-a * tanh(v / b) * abs(load)``.

    It is not searched for among other effects: a diagnosis makes one where they leave something unexplained.
    """

    name: ClassVar[str] = "learned_force"
    phrase: ClassVar[str] = "a force by a learned law on joint"
    searched: ClassVar[bool] = False
    expression: str
    a: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    b: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    c: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    d: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    e: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    f: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    g: float | None = parameter("by the formula", -1e9, 1e9, default=None)
    h: float | None = parameter("by the formula", -1e9, 1e9, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        parsed = parse_expression(self.expression)
        given = {k for k in COEFFICIENTS if getattr(self, k) is not None}
        if given != set(parsed.coefficients):
            wanted = ", ".join(parsed.coefficients) or "none"
            raise ValueError(
                f"learned_force on {self.target!r}: {self.expression!r} has the coefficients {wanted}; "
                f"got values for {', '.join(sorted(given)) or 'none'}"
            )

    @property
    def parsed(self) -> Expression:
        """The formula, parsed."""
        return parse_expression(self.expression)

    @property
    def signals(self) -> frozenset[str]:
        return self.parsed.signals

    @property
    def memories(self) -> int:
        return len(self.parsed.memories)

    @property
    def coefficients(self) -> dict[str, np.ndarray]:
        """Values of the coefficients by name."""
        return {k: np.asarray(getattr(self, k), float) for k in self.parsed.coefficients}

    def force_from(self, signals: JointSignals, memory: np.ndarray) -> np.ndarray:
        value = self.parsed.value({**signals, **self.coefficients}, memory)
        return np.broadcast_to(value, memory.shape[:-1])

    def remember(
        self, before: JointSignals, now: JointSignals, memory: np.ndarray, seconds: float | np.ndarray
    ) -> np.ndarray:
        return self.parsed.step({**before, **self.coefficients}, {**now, **self.coefficients}, memory, seconds)


def layer_sizes(inputs: int, count: int) -> int:
    """Hidden units of a network with one layer that has so many numbers in all.

    Raises:
        ValueError: no network of one hidden layer has as many.
    """
    hidden, rest = divmod(count - 1, inputs + 2)
    if hidden < 1 or rest:
        raise ValueError(f"{count} weights fit no network with {inputs} inputs: h·({inputs} + 2) + 1 are expected")
    return hidden


@dataclass(frozen=True)
class ResidualNetwork(SignalForce):
    """A black box: force = scale · (w₂ · tanh(W₁ x + b₁) + b₂), of signals x divided by their spans.

    A diagnosis does not look for it among other effects: it is made where neither they nor a law explain the rest.
    Outside the spans that it was fitted in, signals are taken to be at their ends.
    """

    name: ClassVar[str] = "residual_network"
    phrase: ClassVar[str] = "a black box's force on joint"
    searched: ClassVar[bool] = False
    inputs: str
    spans: tuple[float, ...] = parameter("by the signal", 1e-9, 1e9)
    weights: tuple[float, ...] = parameter("1", -1e6, 1e6)
    scale: float = parameter("N·m or N", 0.0, 1e9)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = self.inputs.split()
        if not names or any(x not in SIGNALS and x not in MEMORY_INPUTS for x in names):
            known = ", ".join([*SIGNALS, *MEMORY_INPUTS])
            raise ValueError(f"{self.name} on {self.target!r}: inputs must be among {known}; got {self.inputs!r}")
        if len(self.spans) != len(names):
            raise ValueError(f"{self.name} on {self.target!r}: {len(names)} inputs need as many spans")
        layer_sizes(len(names), len(self.weights))

    @property
    def signals(self) -> frozenset[str]:
        return frozenset(MEMORY_INPUTS.get(x, x)[0] if x in MEMORY_INPUTS else x for x in self.inputs.split())

    @property
    def remembered(self) -> list[Expression]:
        """Its inputs with memory, as formulas."""
        return [parse_expression(MEMORY_INPUTS[x][1]) for x in self.inputs.split() if x in MEMORY_INPUTS]

    @property
    def memories(self) -> int:
        return len(self.remembered)

    def remember(
        self, before: JointSignals, now: JointSignals, memory: np.ndarray, seconds: float | np.ndarray
    ) -> np.ndarray:
        parts = [e.step(before, now, memory[..., i : i + 1], seconds) for i, e in enumerate(self.remembered)]
        return np.concatenate(parts, -1) if parts else memory

    def force_from(self, signals: JointSignals, memory: np.ndarray) -> np.ndarray:
        columns, k = [], 0
        for x in self.inputs.split():
            columns.append(memory[..., k] if x in MEMORY_INPUTS else signals[x])
            k += x in MEMORY_INPUTS
        spans = np.array(self.spans)
        x = np.clip(np.stack(columns, -1) / spans, -1.0, 1.0)
        n, w = len(spans), np.array(self.weights)
        hidden = layer_sizes(n, len(w))
        first, bias = w[: hidden * n].reshape(n, hidden), w[hidden * n : hidden * (n + 1)]
        second = w[hidden * (n + 1) : hidden * (n + 2)]
        return self.scale * (np.tanh(x @ first + bias) @ second + w[-1])


MEMORY_INPUTS = {
    "slow_v": ("v", "lowpass(v, 0.1)"),
    "slow_u": ("u", "lowpass(u, 0.1)"),
    "bent": ("q", "hysteresis(0.1)"),
}
"""Inputs of a network that have memory: the signal that each follows, and how."""
