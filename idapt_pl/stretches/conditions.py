"""Conditions on recorded channels, as in ``state == 2`` or ``1.5 < time < 4``: parsed, never evaluated as code."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.stretches.stretch import marked_steps, with_marks

LONGEST_CONDITION = 500
"""Characters."""

COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}  # fmt: skip
HOW_TO_WRITE = "write for example state == 2, 1.5 < time < 4 or estop == 1 and force[2] > 5"


class BadCondition(ValueError):
    """A condition cannot be read, or does not fit the recordings; the message says why and what can be written."""


def parse_condition(text: str) -> ast.expr:
    """A condition as a tree that holds nothing but comparisons of channels and values, ``and``, ``or`` and ``not``.

    Raises:
        BadCondition: it is something else.
    """
    try:
        if len(text) > LONGEST_CONDITION:
            raise ValueError(f"it is longer than {LONGEST_CONDITION} characters")
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        why = error.msg if isinstance(error, SyntaxError) else str(error)
        raise BadCondition(f"condition {text[:80]!r} cannot be read ({why}); {HOW_TO_WRITE}") from None
    if problem := first_problem(tree):
        raise BadCondition(f"condition {text[:80]!r}: {problem}; {HOW_TO_WRITE}")
    return tree


def first_problem(node: ast.expr) -> str:
    """What in a tree is no condition, in words; empty where all is one."""
    match node:
        case ast.BoolOp(values=parts):
            return next(filter(None, map(first_problem, parts)), "")
        case ast.UnaryOp(op=ast.Not(), operand=part):
            return first_problem(part)
        case ast.Compare(left=left, ops=ops, comparators=others):
            if strange := [type(o).__name__ for o in ops if type(o) not in COMPARISONS]:
                return f"{strange[0]} is no comparison that is known (==, !=, <, <=, >, >=)"
            wrong = [o for o in (left, *others) if not is_operand(o)]
            return f"{ast.unparse(wrong[0])!r} is neither a channel nor a value" if wrong else ""
    return f"{ast.unparse(node)!r} compares nothing"


def is_operand(node: ast.expr) -> bool:
    """Whether a part of a comparison is a channel, a column of one or a value."""
    match node:
        case ast.Name():
            return True
        case ast.Constant(value=value):
            return isinstance(value, int | float | str)
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=ast.Constant(value=value)):
            return isinstance(value, int | float)
        case ast.Subscript(value=ast.Name() | ast.Constant(value=str()), slice=ast.Constant(value=value)):
            return isinstance(value, int)
    return False


def kept_steps(condition: str, number: int, episode: Episode, dt: float, holds: bool = True) -> np.ndarray:
    """Control steps of an episode throughout which a condition holds, or does not hold, (T,) bool.

    A channel with a row for each observation counts at both ends of a step, one with a row for each action as it is.

    Args:
        condition: as :func:`parse_condition` takes it.
        number: of the episode.
        episode: with the channels: ``time`` [s from its start], ``episode``, ``infos``, observations and ``actions``.
        dt: control period, s.
        holds: whether it is to hold.

    Raises:
        BadCondition: it cannot be read, or names a channel that is not there.
    """
    tree, T = parse_condition(condition), len(episode)
    where = f"condition {condition[:80]!r}: episode_{number}"
    channels, kept = channels_named(tree, where, number, episode, dt), np.ones(T, bool)
    for end in (0, 1):
        at_end = {k: v if len(v) == T else v[end : T + end] for k, v in channels.items()}
        held = truth(tree, at_end, T, where)
        kept &= held if holds else ~held
    return kept


def channels_named(tree: ast.expr, where: str, number: int, episode: Episode, dt: float) -> dict[str, np.ndarray]:
    """The channels that a condition names.

    Raises:
        BadCondition: one is not there, or has neither a row for each step nor for each observation.
    """
    known, T = known_channels(number, episode, dt), len(episode)
    named = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    named |= {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and n.value in known}
    found = {}
    for name in sorted(named):
        if name not in known:
            raise BadCondition(f"{where} has no channel {name!r}; it has: {', '.join(sorted(known))}")
        if known[name].ndim < 1 or len(known[name]) not in (T, T + 1):
            raise BadCondition(f"{where}: channel {name!r} has shape {known[name].shape}, expected {T} or {T + 1} rows")
        found[name] = known[name]
    return found


def known_channels(number: int, episode: Episode, dt: float) -> dict[str, np.ndarray]:
    """All that conditions may be on, by name."""
    T = len(episode)
    time = dt * np.arange(T + 1) if episode.timestamps is None else episode.timestamps - episode.timestamps[0]
    seen = {k: v for k, v in episode.observations.items() if k != "pixels"}
    own = {"time": time, "episode": np.full(T + 1, number)}
    return {"actions": episode.actions, **seen, **episode.infos, **own}


def truth(node: ast.expr, channels: Mapping[str, np.ndarray], rows: int, where: str) -> np.ndarray:
    """Where a condition holds, (rows,) bool."""
    match node:
        case ast.BoolOp(op=op, values=parts):
            each = np.stack([truth(p, channels, rows, where) for p in parts])
            return np.asarray(each.all(0) if isinstance(op, ast.And) else each.any(0))
        case ast.UnaryOp(operand=part):
            return np.logical_not(truth(part, channels, rows, where))
        case ast.Compare(left=left, ops=ops, comparators=others):
            values = [operand(o, channels, where) for o in (left, *others)]
            holds = np.ones(rows, bool)
            for compared, a, b in zip(ops, values[:-1], values[1:], strict=True):
                if (np.asarray(a).dtype.kind in "US") != (np.asarray(b).dtype.kind in "US"):
                    raise BadCondition(f"{where}: {ast.unparse(node)!r} compares words with numbers")
                holds &= np.broadcast_to(COMPARISONS[type(compared)](a, b), rows)
            return holds
    raise AssertionError("checked by first_problem")


def operand(node: ast.expr, channels: Mapping[str, np.ndarray], where: str) -> Any:
    """A value, or a channel's rows, (rows,).

    Raises:
        BadCondition: a channel has several columns and none is named, or not so many.
    """
    match node:
        case ast.UnaryOp(op=op, operand=ast.Constant(value=value)) if isinstance(value, int | float):
            return -value if isinstance(op, ast.USub) else value
        case ast.Subscript(value=inner, slice=ast.Constant(value=int(column))):
            name = inner.id if isinstance(inner, ast.Name) else str(getattr(inner, "value", ""))
            table = channels[name].reshape(len(channels[name]), -1)
            if not 0 <= column < table.shape[1]:
                raise BadCondition(f"{where}: channel {name!r} has columns 0 to {table.shape[1] - 1}, not {column}")
            return as_text(table[:, column])
        case ast.Constant(value=value) if value not in channels:
            return value
    name = node.id if isinstance(node, ast.Name) else str(getattr(node, "value", ""))
    table = channels[name].reshape(len(channels[name]), -1)
    if table.shape[1] != 1:
        raise BadCondition(f"{where}: channel {name!r} has {table.shape[1]} columns: say which, as in {name}[0]")
    return as_text(table[:, 0])


def as_text(column: np.ndarray) -> np.ndarray:
    """A channel, (rows,); words as text."""
    if column.dtype.kind not in "SO":
        return column
    return np.array([v.decode(errors="replace") if isinstance(v, bytes) else str(v) for v in column])


def mark_by_conditions(data: Trajectories, only: Sequence[str] = (), without: Sequence[str] = ()) -> Trajectories:
    """Recordings of which all is left out but the steps where all of ``only`` hold and none of ``without`` does.

    Raises:
        BadCondition: a condition cannot be read, does not fit, or nothing is left.
    """
    if not (only or without):
        return data
    episodes, left = [], 0
    for i, e in enumerate(data):
        marked = marked_steps(e).copy()
        for condition in only:
            marked |= ~kept_steps(condition, i, e, data.dt)
        for condition in without:
            marked |= ~kept_steps(condition, i, e, data.dt, holds=False)
        left += int((~marked).sum())
        episodes.append(with_marks(e, marked))
    if not left:
        told = " and ".join([*(f"--only {c!r}" for c in only), *(f"--without {c!r}" for c in without)])
        raise BadCondition(f"{told} leave no control step; {values_taken(data, [*only, *without])}")
    return replace(data, episodes=tuple(episodes))


def idle_conditions(data: Trajectories, only: Sequence[str] = (), without: Sequence[str] = ()) -> list[str]:
    """Conditions that leave nothing out of the recordings, a sentence each."""
    options = [("only", c, True) for c in only] + [("without", c, False) for c in without]
    return [
        f"--{option} {c!r} leaves nothing out; {values_taken(data, [c])}"
        for option, c, holds in options
        if all(kept_steps(c, i, e, data.dt, holds).all() for i, e in enumerate(data))
    ]


def values_taken(data: Trajectories, conditions: Sequence[str]) -> str:
    """Which values the channels take that conditions name, in words."""
    told = []
    names = {n.id for c in conditions for n in ast.walk(parse_condition(c)) if isinstance(n, ast.Name)}
    for name in sorted(names):
        every = np.concatenate([np.ravel(known_channels(i, e, data.dt)[name]) for i, e in enumerate(data)])
        values = np.unique(every)
        shown = ", ".join(map(str, values[:8].tolist())) if len(values) <= 8 else f"{values[0]} to {values[-1]}"
        told.append(f"{name} is {shown}")
    return "; ".join(told) or "name a channel"
