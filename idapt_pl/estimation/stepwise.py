"""Stepwise selection: add what helps most until nothing does, then leave out what has become needless."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

State = TypeVar("State")
Item = TypeVar("Item")


def forward_selection(state: State, step: Callable[[State, int], tuple[State, bool]], most: int) -> State:
    """Greedy forward selection: apply ``step`` until it adds nothing, at most ``most`` times.

    Args:
        state: what was selected before, and whatever goes along with it. Not changed: steps return another one.
        step: from a state and the number of steps taken, the next state and whether anything was added. The last
            state counts even where nothing was added: it may say what was tried in vain.
        most: steps at most.
    """
    for taken in range(most):
        state, added = step(state, taken)
        if not added:
            break
    return state


def backward_elimination(
    state: State, items: Sequence[Item], without: Callable[[State, Item], State | None], least: int = 1
) -> State:
    """Backward elimination in one pass: leave out each item that the others can do without.

    Args:
        state: with all of the items.
        items: what may be left out, in the order in which it is tried.
        without: the state without an item where it is needless, else None. Gets the state with all earlier items
            that were needless left out already.
        least: so many items always stay; where no more are left, nothing further is tried.
    """
    left = len(items)
    for item in items:
        if left <= least:
            break
        smaller = without(state, item)
        if smaller is not None:
            state, left = smaller, left - 1
    return state
