"""Formulas of forces in a small grammar: parsed and checked, never run as code.

    -a * tanh(v / b) * abs(load) + c * hysteresis(0.05)

Numbers, ``+ - * /``, ``**`` with a number, brackets, the functions below, signals (``SIGNALS``) and coefficients, which
are single letters of ``COEFFICIENTS``. Two functions have memory: ``lowpass(x, seconds)`` is x behind a first-order
filter, and ``hysteresis(width)`` goes from -1 to 1 as the joint moves, and back only when it turns round (Dahl, 1968):
dz = (1 - sign(dq) z) dq / width.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

SIGNALS = {
    "q": "position of the joint",
    "v": "its velocity",
    "u": "command of the actuator on it",
    "motor": "what actuators do at the joint",
    "load": "what gravity and the other links' motion ask of it",
    "t": "time in the episode",
}
"""What a formula may depend on."""

COEFFICIENTS = "abcdefgh"
"""Names of coefficients."""

FUNCTIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "abs": np.abs, "cos": np.cos, "exp": lambda x: np.exp(np.minimum(x, 50.0)), "positive": lambda x: np.maximum(x, 0),
    "sign": np.sign, "sin": np.sin, "sqrt": lambda x: np.sqrt(np.maximum(x, 0)), "tanh": np.tanh,
}  # fmt: skip
"""Functions without memory; ``positive(x)`` is x where that is above 0, else 0."""

LONGEST = 400
"""Characters that a formula may have."""

Values = Mapping[str, np.ndarray]
"""Signals and coefficients by name; arrays of one shape, or numbers."""


@dataclass(frozen=True)
class Expression:
    """A parsed formula.

    Attributes:
        tree: its root.
        memories: calls of functions with memory, in the order of their states.
        names: of all signals and coefficients in it.
    """

    tree: ast.expr
    memories: tuple[ast.Call, ...]
    names: frozenset[str]

    @property
    def signals(self) -> frozenset[str]:
        """Signals that it depends on, hysteresis by way of the position."""
        moving = {"q"} if any(call_name(m) == "hysteresis" for m in self.memories) else set()
        return frozenset((self.names & set(SIGNALS)) | moving)

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Coefficients in it, by the alphabet."""
        return tuple(sorted(self.names & set(COEFFICIENTS)))

    def value(self, values: Values, memory: np.ndarray) -> np.ndarray:
        """What it comes to, no number and infinity as 0; ``memory``: states, (..., memories)."""
        with np.errstate(all="ignore"):
            states = [memory[..., i] for i in range(len(self.memories))]
            result = value_of(self.tree, values, states, self.memories)
        return np.where(np.abs(result) < 1e12, result, 0.0)

    def step(self, before: Values, now: Values, memory: np.ndarray, seconds: float | np.ndarray) -> np.ndarray:
        """The states after signals went from one value to the next in so many seconds, (..., memories)."""
        after = memory.copy()
        for i, call in enumerate(self.memories):
            x = value_of(call.args[-1], before, [], ())
            if call_name(call) == "lowpass":
                with np.errstate(all="ignore"):
                    reached = np.nan_to_num(value_of(call.args[0], before, [], ()), posinf=0.0, neginf=0.0)
                share = -np.expm1(-seconds / np.maximum(x, 1e-9))
                after[..., i] += share * (reached - memory[..., i])
            else:
                moved = now["q"] - before["q"]
                side = np.sign(moved)
                after[..., i] = side + (memory[..., i] - side) * np.exp(-np.abs(moved) / np.maximum(x, 1e-12))
                after[..., i] = np.where(moved == 0, memory[..., i], after[..., i])
        return after


def call_name(call: ast.Call) -> str:
    """What a call calls."""
    return call.func.id if isinstance(call.func, ast.Name) else ""


@lru_cache(maxsize=1024)
def parse_expression(text: str) -> Expression:
    """Read a formula.

    Raises:
        ValueError: it is no formula of this grammar; says what is not, and what may be.
    """
    if not isinstance(text, str) or len(text) > LONGEST:
        raise ValueError(f"a formula is text of at most {LONGEST} characters, got {str(text)[:40]!r}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"{text!r} is no formula; expected something like -a * tanh(v / b)") from None
    memories: list[ast.Call] = []
    names: set[str] = set()
    check(tree, text, memories, names, inside=False)
    return Expression(tree, tuple(memories), frozenset(names))


def check(node: ast.expr, text: str, memories: list[ast.Call], names: set[str], inside: bool) -> None:
    """Refuse what is not in the grammar; note functions with memory and names. ``inside``: of one with memory."""
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as number) if abs(float(number)) < 1e12:
            return
        case ast.Name(id=name) if name in SIGNALS or name in COEFFICIENTS:
            if inside and name in ("motor", "load"):
                raise ValueError(f"{text!r}: a formula cannot remember {name}; lowpass takes q, v, u and t")
            names.add(name)
            return
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            return check(operand, text, memories, names, inside)
        case ast.BinOp(op=ast.Pow(), left=left, right=ast.Constant(value=int() | float())):
            return check(left, text, memories, names, inside)
        case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div(), left=left, right=right):
            check(left, text, memories, names, inside)
            return check(right, text, memories, names, inside)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return check(argument, text, memories, names, inside)
        case ast.Call(func=ast.Name(id="lowpass" | "hysteresis" as name), args=args, keywords=[]) if not inside:
            if len(args) == (2 if name == "lowpass" else 1) and constant(args[-1]):
                memories.append(node)
                for argument in args:
                    check(argument, text, memories, names, inside=True)
                return
    raise ValueError(
        f"{text!r}: {ast.unparse(node)!r} is not allowed in a formula. It may have numbers, + - * / **, the signals "
        f"{', '.join(SIGNALS)}, coefficients a to h, {', '.join(sorted(FUNCTIONS))}, lowpass(x, seconds) and "
        "hysteresis(width)"
    )


def constant(node: ast.expr) -> bool:
    """Whether something is a number or a coefficient."""
    return isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and node.id in COEFFICIENTS)


def value_of(
    node: ast.expr, values: Values, memory: Sequence[np.ndarray], memories: tuple[ast.Call, ...]
) -> np.ndarray:
    """What a checked node comes to."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return np.asarray(float(number))
        case ast.Name(id=name):
            return np.asarray(values[name], float)
        case ast.UnaryOp(op=op, operand=operand):
            inner = value_of(operand, values, memory, memories)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.BinOp(left=left, op=op, right=right):
            return combine(op, value_of(left, values, memory, memories), value_of(right, values, memory, memories))
        case ast.Call() if node in memories:
            return memory[memories.index(node)]
        case ast.Call(args=[argument]):
            return FUNCTIONS[call_name(node)](value_of(argument, values, memory, memories))
    raise AssertionError(f"a checked formula has no {ast.dump(node)}")


def combine(op: ast.operator, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Two numbers joined; what is divided by 0 is 0."""
    match op:
        case ast.Add():
            return left + right
        case ast.Sub():
            return left - right
        case ast.Mult():
            return left * right
        case ast.Div():
            return np.where(right == 0, 0.0, left / right)
        case _:
            return left**right
