"""Which column may be which joint and actuator: by names, by order where they are numbered, or as the only one left."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from datamodules.recordings.draft_names import (
    COMMAND,
    OTHER_KIND,
    POSITION,
    agreement,
    kind_of,
    telling_words,
    words_of,
)
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.topics import topic_of, topics_in

WEAK = ("effort", "volt", "volts", "voltage", "current", "motor")
"""Words of what is measured as often as it is commanded."""


@dataclass(frozen=True)
class Match:
    """A column for a joint or actuator, and why."""

    column: str
    why: str


def usable_columns(recorded: Recorded) -> list[str]:
    """Columns of numbers, each under one name; where topics were joined, most cells of one may be empty."""
    columns = {name: recorded.columns[name] for name in single_names(recorded)}
    return [name for name, a in columns.items() if a.dtype.kind in "fiu" and a.ndim == 1 and np.isfinite(a).sum() > 1]


def single_names(recorded: Recorded) -> list[str]:
    """Names of columns; where elements go by number and by label, the labels alone."""
    labels: dict[str, int] = defaultdict(int)
    numbers: dict[str, int] = defaultdict(int)
    for name in recorded.columns:
        base, _, element = name.removesuffix("]").rpartition("[")
        (numbers if element.isdigit() else labels)[base] += bool(base)
    twice = {base for base, n in numbers.items() if n and labels[base] == n}
    return [
        name
        for name in recorded.columns
        if not (name.rpartition("[")[0] in twice and name.removesuffix("]").rpartition("[")[2].isdigit())
    ]


def is_finite(values: np.ndarray) -> bool:
    """Whether a column holds numbers, with nearly none missing."""
    return (
        values.dtype.kind in "fiu" and values.ndim == 1 and len(values) > 1 and bool(np.isfinite(values).mean() > 0.5)
    )


def match(
    subjects: dict[str, set[str]], kind: str, recorded: Recorded, free: list[str], beside: dict[str, str] | None = None
) -> dict[str, Match]:
    """Columns for joints or actuators, each column for one of them.

    Args:
        subjects: names, in the model's order, and the words that tell them.
        kind: of quantity that is wanted.
        recorded: the columns.
        free: names of those that are not taken.
        beside: columns by subject whose rows the wanted ones should have, if any.
    """
    taken: dict[str, Match] = {}
    scored = []
    for column in free:
        for subject, words in subjects.items():
            if score := _score(column, words, kind, recorded, (beside or {}).get(subject)):
                scored.append((score, column, subject))
    left = list(free)
    for _, column, subject in sorted(scored, key=lambda s: -s[0]):
        if subject not in taken and column in left:
            shared = sorted(subjects[subject] & set(words_of(column)))
            taken[subject] = Match(column, f"{' and '.join(shared)} in its name")
            left.remove(column)
    moving = [c for c in left if np.nanmax(recorded.columns[c]) > np.nanmin(recorded.columns[c])]
    taken |= _numbered(list(subjects), taken, kind, moving, topics_in(recorded.columns))
    if len(taken) == len(subjects) - 1:
        alone = [c for c in moving if c not in {m.column for m in taken.values()} and kind_of(c) == kind]
        strong = [c for c in alone if not set(telling_words(c)) & set(WEAK)] or alone
        if len(strong) == 1:
            (subject,) = (s for s in subjects if s not in taken)
            taken[subject] = Match(strong[0], f"the only {kind} left")
    return taken


def _score(column: str, words: set[str], kind: str, recorded: Recorded, beside: str | None) -> float:
    """How well a column's name fits; 0: not at all."""
    named, found = agreement(words, column), kind_of(column)
    if not named or found not in ("", kind):
        return 0.0
    shared = words & set(words_of(column))
    if not found and all(word.isdigit() for word in shared):  # a number alone tells little: many things are counted
        return 0.0
    alone = set(words_of(column)) == words
    if not found and kind != POSITION and not (kind == COMMAND and alone):
        return 0.0
    score = 4 * named + 2 * (found == kind)
    score -= 0.5 * bool(set(telling_words(column)) & set(WEAK)) * (kind == COMMAND)
    values = recorded.columns[column]
    if beside is not None and len(values) == len(recorded.columns[beside]):
        score += 0.25
    if beside is not None and column.partition(".")[0] == beside.partition(".")[0]:
        score += 0.25
    if np.nanmax(values) == np.nanmin(values):
        score -= 1
    return score


def _numbered(
    subjects: list[str], taken: dict[str, Match], kind: str, left: list[str], topics: list[str]
) -> dict[str, Match]:
    """Elements of an array, as many as there are joints or actuators: the n-th is the n-th one's.

    Elements with labels count only if no name was found at all: the model calls its joints differently then.

    Where several such groups would do equally well, none is taken.
    """
    fitting: dict[bool, list[tuple[str, list[str]]]] = {True: [], False: []}
    for pattern, columns in _groups(left, topics) + ([] if taken else _labelled_groups(left)):
        named = kind_of(pattern)
        if len(columns) == len(subjects) and (named == kind or (not named and kind == POSITION)):
            fitting[named == kind].append((pattern, columns))
        elif len(columns) == 2 * len(subjects) and not named and kind != COMMAND:
            first = 0 if kind == POSITION else len(subjects)  # positions, then velocities, as in many observations
            fitting[False].append((pattern, columns[first:]))
    groups = fitting[True] or fitting[False]
    groups = [group for group in groups if not set(words_of(group[0])) & set(WEAK)] or groups
    if len({re.sub(r"\W*\d+", "", pattern) for pattern, _ in groups}) != 1:  # instances of a topic count as one
        return {}
    why = "BY ITS PLACE ONLY, if the order is the model's"
    pairs = zip(subjects, groups[0][1], strict=False)
    return {subject: Match(column, why) for subject, column in pairs if subject not in taken}


def _labelled_groups(columns: list[str]) -> list[tuple[str, list[str]]]:
    """Elements that go by labels, as ``state[pan.pos]`` and ``state[lift.pos]``; the array's name, and they."""
    groups: dict[str, list[str]] = defaultdict(list)
    for column in columns:
        base, _, element = column.removesuffix("]").rpartition("[")
        if base and not element.isdigit():
            groups[base].append(column)
    return list(groups.items())


def _groups(columns: Iterable[str], topics: list[str]) -> list[tuple[str, list[str]]]:
    """Names that differ in one number, which counts up, as ``q[0]``, ``q[1]``; the name without it, and they.

    A number in the name of a topic tells instances of it apart, not joints.
    """
    groups: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for column in columns:
        found = re.fullmatch(r"(.*?)(\d{1,4})(\D*)", column)
        if found and len(found[1]) > len(topic_of(column, topics) or ""):
            groups[f"{found[1]} {found[3]}"].append((int(found[2]), column))
    out = []
    for pattern, members in groups.items():
        members.sort()
        numbers = [n for n, _ in members]
        if numbers == list(range(numbers[0], numbers[0] + len(numbers))) and kind_of(pattern) != OTHER_KIND:
            out.append((pattern, [column for _, column in members]))
    return out
