"""Distributions over effects: what domain randomisation draws worlds from.

A domain is a model and a list of effects, so a distribution over domains is a list of effects whose parameters are
drawn. As YAML::

    - effect: body_mass
      target: pole
      parameters: {mass: {log_uniform: [2.5, 10.0]}}
    - one_of:
      - {effect: texture, target: sky, parameters: {flat: {uniform: [[0, 0, 0], [1, 1, 1]]}}}
      - {effect: texture, target: sky, parameters: {dm_control: skybox.xml}}
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from idapt_pl.effects.base import EFFECTS
from idapt_pl.effects.domain import Domain

ENTRY = {"effect", "target", "parameters"}
"""Keys of an effect whose parameters are drawn."""


@dataclass(frozen=True)
class ParameterDraw(ABC):
    """What a parameter is drawn from."""

    @property
    @abstractmethod
    def ends(self) -> tuple[Any, ...]:
        """Values that show whether all it can give makes sense."""

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> Any:
        """One value."""


@dataclass(frozen=True)
class Uniform(ParameterDraw):
    """Uniform from ``low`` to ``high``, numbers or vectors; a vector's components are drawn independently."""

    low: Any
    high: Any

    def __post_init__(self) -> None:
        low, high = np.asarray(self.low, float), np.asarray(self.high, float)
        if low.shape != high.shape or low.ndim > 1 or not (low <= high).all():
            raise ValueError(f"the ends must be two numbers or vectors, the lower first; got {self.low}, {self.high}")

    @property
    def ends(self) -> tuple[Any, ...]:
        return self.low, self.high

    def sample(self, rng: np.random.Generator) -> Any:
        low, high = np.asarray(self.low, float), np.asarray(self.high, float)
        return plain(self.between(rng.random(low.shape), low, high).clip(low, high))

    @staticmethod
    def between(share: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Values at shares 0 to 1 of the way from one end to the other."""
        return low + (high - low) * share


@dataclass(frozen=True)
class LogUniform(Uniform):
    """Uniform in the logarithm: as often between 1 and 2 as between 2 and 4."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.asarray(self.low, float) > 0).all():
            raise ValueError(f"log_uniform needs ends above zero, got {self.low}")

    @staticmethod
    def between(share: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return low * (high / low) ** share


@dataclass(frozen=True)
class Choice(ParameterDraw):
    """One of several values, each as often."""

    options: tuple[Any, ...]

    @property
    def ends(self) -> tuple[Any, ...]:
        return self.options

    def sample(self, rng: np.random.Generator) -> Any:
        return self.options[int(rng.integers(len(self.options)))]


DRAWS = ("uniform", "log_uniform", "choice")
"""Words for what a parameter is drawn from."""


def plain(value: np.ndarray) -> float | tuple[float, ...]:
    """An array of no or one dimension as effects have it."""
    return float(value) if value.ndim == 0 else tuple(map(float, value))


def draw_from(spec: Any) -> ParameterDraw:
    """What ``{uniform: [low, high]}``, ``{log_uniform: [low, high]}``, ``{choice: [...]}`` or a plain value says.

    Raises:
        ValueError: if it is none of them.
    """
    if not isinstance(spec, Mapping):
        return Choice((spec,))
    if len(spec) != 1 or (word := next(iter(spec))) not in DRAWS:
        raise ValueError(f"a parameter is a value or one of {', '.join(DRAWS)} with a list, got {dict(spec)}")
    values = spec[word]
    if not isinstance(values, Sequence) or isinstance(values, str) or not values:
        raise ValueError(f"{word} takes a list, got {values!r}")
    if word == "choice":
        return Choice(tuple(values))
    if len(values) != 2:
        raise ValueError(f"{word} takes two ends, [low, high], got {len(values)} values")
    try:
        return (Uniform if word == "uniform" else LogUniform)(*values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{word}: {error}") from None


@dataclass(frozen=True)
class DrawnEffect:
    """An effect whose parameters are drawn.

    Attributes:
        effect: name of the effect.
        targets: what it is on; each has values of its own.
        parameters: those that are drawn or fixed. Others stay what they are in the domain, where that has this effect.
    """

    effect: str
    targets: tuple[str, ...]
    parameters: Mapping[str, ParameterDraw]

    def lay_over(self, domain: Domain, values: Sequence[Mapping[str, Any]]) -> Domain:
        """The domain with the effect on every target: in place of the one it has there, or after the others.

        Raises:
            ValueError: if a value is out of the effect's bounds, or one is missing.
        """
        effects = list(domain.effects)
        for target, given in zip(self.targets, values, strict=True):
            places = [i for i, e in enumerate(effects) if (e.name, e.target) == (self.effect, target)]
            try:
                if places:
                    effects[places[-1]] = replace(effects[places[-1]], **given)
                else:
                    effects.append(EFFECTS[self.effect](target, **given))
            except TypeError:
                known = ", ".join(f.name for f in fields(EFFECTS[self.effect]) if f.name != "target")
                raise ValueError(
                    f"{self.effect} on {target!r}: parameters {sorted(given)} do not make one, which has {known}"
                ) from None
        return Domain(domain.name, domain.base, tuple(effects))

    def sample(self, domain: Domain, rng: np.random.Generator) -> Domain:
        """The domain with drawn values."""
        return self.lay_over(domain, [{k: d.sample(rng) for k, d in self.parameters.items()} for _ in self.targets])

    @property
    def breadth(self) -> int:
        """How many extremes there are to look at."""
        return max((len(d.ends) for d in self.parameters.values()), default=1)

    def extreme(self, domain: Domain, i: int) -> Domain:
        """The domain with every parameter at its i-th end, counted round."""
        values = {k: d.ends[i % len(d.ends)] for k, d in self.parameters.items()}
        return self.lay_over(domain, [values] * len(self.targets))


@dataclass(frozen=True)
class OneOf:
    """One of several distributions, each as often."""

    options: tuple[DomainDistribution, ...]

    def sample(self, domain: Domain, rng: np.random.Generator) -> Domain:
        """The domain with what was drawn."""
        return self.options[int(rng.integers(len(self.options)))].sample(domain, rng)

    @property
    def breadth(self) -> int:
        """How many extremes there are to look at."""
        return sum(option.breadth for option in self.options)

    def extreme(self, domain: Domain, i: int) -> Domain:
        """The i-th of all extremes of its options, counted round."""
        i %= self.breadth
        for option in self.options:
            if i < option.breadth:
                return option.extreme(domain, i)
            i -= option.breadth
        raise AssertionError("counted round")


@dataclass(frozen=True)
class DomainDistribution:
    """A distribution over domains: drawn effects, in order."""

    parts: tuple[DrawnEffect | OneOf, ...] = ()

    def sample(self, domain: Domain, rng: np.random.Generator) -> Domain:
        """A variant of a domain."""
        for part in self.parts:
            domain = part.sample(domain, rng)
        return domain

    def then(self, others: DomainDistribution) -> DomainDistribution:
        """With others drawn after these; where both draw the same effect it is theirs."""
        return DomainDistribution((*self.parts, *others.parts))

    @property
    def breadth(self) -> int:
        """How many extremes there are to look at."""
        return max((part.breadth for part in self.parts), default=1)

    def extreme(self, domain: Domain, i: int) -> Domain:
        """The domain with everything at its i-th end, counted round."""
        for part in self.parts:
            domain = part.extreme(domain, i)
        return domain

    def check(self, domain: Domain) -> None:
        """Compile the domain at every end.

        Raises:
            ValueError: saying which effect does not fit the model, or what compiles to no model.
        """
        for i in range(self.breadth):
            self.extreme(domain, i).compile()


ALWAYS_THE_SAME = DomainDistribution()
"""Nothing is drawn."""


def distribution_from(entries: Any) -> DomainDistribution:
    """From the YAML form: one entry or a list of them.

    Raises:
        ValueError: saying which entry is wrong, and how.
    """
    listed = [entries] if isinstance(entries, Mapping) else entries
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise ValueError(f"a distribution over effects is a list of entries, got {type(entries).__name__}")
    return DomainDistribution(tuple(part_from(entry, i) for i, entry in enumerate(listed, 1)))


def part_from(entry: Any, number: int) -> DrawnEffect | OneOf:
    """From one entry of the YAML form; errors name its place in the list."""
    if isinstance(entry, Mapping) and set(entry) == {"one_of"} and isinstance(entry["one_of"], Sequence):
        return OneOf(tuple(distribution_from(option) for option in entry["one_of"]))
    if not isinstance(entry, Mapping) or "effect" not in entry or set(entry) - ENTRY:
        raise ValueError(f"entry {number}: needs effect, target, parameters, or one_of alone; got {entry!r}")
    name, targets, given = entry["effect"], entry.get("target", "*"), entry.get("parameters") or {}
    if name not in EFFECTS:
        raise ValueError(f"entry {number}: unknown effect {name!r}; known effects: {', '.join(sorted(EFFECTS))}")
    known = {f.name for f in fields(EFFECTS[name])} - {"target"}
    if not isinstance(given, Mapping) or not set(given) <= known:
        raise ValueError(f"entry {number}, {name}: parameters must be among {sorted(known)}, got {given!r}")
    try:
        parameters = {k: draw_from(spec) for k, spec in given.items()}
    except ValueError as error:
        raise ValueError(f"entry {number}, {name}: {error}") from None
    return DrawnEffect(name, (targets,) if isinstance(targets, str) else tuple(targets), parameters)


def within_intervals(found: Sequence[Mapping[str, Any]]) -> DomainDistribution:
    """Uniform over the 95 % intervals of effects that a discovery or a diagnosis found.

    Args:
        found: entries with ``effect``, ``target``, ``parameters`` and, where it is known, ``ci95``: parameter to
            (low, high).
    """
    parts = []
    for entry in found:
        intervals = entry.get("ci95") or {}
        given = {k: {"uniform": list(intervals[k])} if k in intervals else v for k, v in entry["parameters"].items()}
        parts.append(part_from({"effect": entry["effect"], "target": entry["target"], "parameters": given}, 1))
    return DomainDistribution(tuple(parts))


def listed_effects(domain: Domain) -> list[dict[str, Any]]:
    """A domain's effects in their YAML form."""
    return [effect.to_dict() for effect in domain.effects]
