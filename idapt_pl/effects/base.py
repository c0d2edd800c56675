"""Effects: named, typed edits of an MJCF model, the one vocabulary for differences between worlds.

An effect says *what* is different (``body_mass``), *where* (``pole``) and *by how much*
(``mass: 200`` kg). A benchmark's target domain, a randomisation range, a diagnosis and a repaired
model are all lists of effects. As YAML::

    - effect: body_mass
      target: pole
      parameters: {mass: 200.0}
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.driven import names_of_joints_of_actuators

if TYPE_CHECKING:
    from idapt_pl.effects.candidate import Candidate, TypicalSizes

EFFECTS: dict[str, type[Effect]] = {}
"""Every effect by its name. A class is entered when it is defined."""


def parameter(unit: str, low: float, high: float, **default: Any) -> Any:
    """Declare one parameter of an effect: its SI unit and its physical bounds (inclusive)."""
    return field(metadata={"unit": unit, "low": low, "high": high}, **default)


@dataclass(frozen=True)
class Effect(ABC):
    """One edit of an ``mujoco.MjSpec``. A subclass with a ``name`` is registered in :data:`EFFECTS`.

    Attributes:
        name: in YAML, JSON and ``--candidates``; classes that others build on have none.
        phrase: what it is called in a sentence. The target follows, unless that is the world; for all elements the
            last word becomes a plural.
        searched: whether a diagnosis looks for it in recorded motion. The docstring of one that is not says why.
        told_anyway: parameters that a sentence gives though they were not estimated, as they say which effect it is.
        target: MJCF name of the element edited, or ``"*"`` for all elements of that kind; of joints also
            ``"actuated"``.
    """

    name: ClassVar[str] = ""
    phrase: ClassVar[str] = ""
    searched: ClassVar[bool] = True
    told_anyway: ClassVar[tuple[str, ...]] = ()
    target: str

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        name = vars(cls).get("name")
        if not name:
            return
        known = EFFECTS.setdefault(name, cls)
        if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ValueError(f"{known.__qualname__} and {cls.__qualname__} are both called {name!r}: rename one")
        EFFECTS[name] = cls

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if isinstance(value, list):  # YAML gives lists; a frozen value must be hashable
                object.__setattr__(self, f.name, tuple(value))
            if "unit" not in f.metadata or value is None:
                continue
            try:
                numbers = np.asarray(value, dtype=float)
            except (TypeError, ValueError):
                raise ValueError(f"{self.name} on {self.target!r}: {f.name} must be numeric, got {value!r}") from None
            low, high, unit = f.metadata["low"], f.metadata["high"], f.metadata["unit"]
            if not (np.isfinite(numbers).all() and (numbers >= low).all() and (numbers <= high).all()):
                raise ValueError(
                    f"{self.name} on {self.target!r}: {f.name} = {value} {unit} is outside [{low}, {high}] {unit}"
                )

    @abstractmethod
    def apply(self, spec: mujoco.MjSpec) -> None:
        """Edit ``spec`` in place. Raises ValueError if the target does not exist."""

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """The hypotheses that a diagnosis tries for this effect; none unless a class says otherwise.

        Args:
            model: the nominal one, without effects.
            typical: sizes in the recordings, for scales.
        """
        return []

    def to_dict(self) -> dict[str, Any]:
        """The YAML/JSON form: ``{effect, target, parameters}`` (unset parameters left out)."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "target"}
        parameters = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if v is not None}
        return {"effect": self.name, "target": self.target, "parameters": parameters}


def effect_from_dict(entry: Mapping[str, Any]) -> Effect:
    """Build an effect from its YAML form; errors name the key and list what is known."""
    if not isinstance(entry, Mapping) or "effect" not in entry:
        raise ValueError(f"an effect needs the keys effect, target, parameters; got {entry!r}")
    name = entry["effect"]
    if name not in EFFECTS:
        raise ValueError(f"unknown effect {name!r}; known effects: {', '.join(sorted(EFFECTS))}")
    if unknown := set(entry) - {"effect", "target", "parameters"}:
        raise ValueError(f"effect {name!r}: unknown key {sorted(unknown)}; an effect has effect, target, parameters")
    try:
        return EFFECTS[name](target=entry.get("target", "*"), **entry.get("parameters", {}))
    except TypeError:
        known = {f.name: f for f in dataclasses.fields(EFFECTS[name]) if f.name != "target"}
        given = sorted(entry.get("parameters") or {})
        lacking = [k for k, f in known.items() if f.default is dataclasses.MISSING and k not in given]
        if lacking and set(given) <= set(known):
            raise ValueError(f"effect {name!r}: {', '.join(lacking)} is missing; got {given}") from None
        raise ValueError(f"effect {name!r}: parameters must be among {list(known)}, got {given}") from None


def find_elements(spec: mujoco.MjSpec, kind: str, target: str) -> list[Any]:
    """The elements of one kind (``"joints"``, ``"geoms"``, ...) called ``target``, or all for ``"*"``.

    Raises:
        ValueError: if there is none; it lists those that there are.
    """
    everything: Iterable[Any] = getattr(spec, kind)
    found = [e for e in everything if target in ("*", e.name)]
    if not found:
        names = ", ".join(e.name or "<unnamed>" for e in everything)
        singular = "body" if kind == "bodies" else kind[:-1]
        raise ValueError(f"the model has no {singular} named {target!r}; it has: {names or 'none'}")
    return found


def names_in(target: str, names: Iterable[str]) -> tuple[str, ...]:
    """Which of these names a target is made of: one of them, two with a space between, or none.

    Names may have spaces in them.
    """
    known = [name for name in names if name]
    if target in known:
        return (target,)
    pairs = ((first, target.removeprefix(f"{first} ")) for first in known if target.startswith(f"{first} "))
    return next((pair for pair in pairs if pair[1] in known and pair[1] != pair[0]), ())


PLAY_SUFFIX = " play"
"""What the name of a joint behind another one, which is its play, ends in; to other effects it is none."""

ACTUATED = "actuated"
"""The target of effects on all joints that an actuator acts on: motors and gears, not the joints of a free base."""


def find_joints(spec: mujoco.MjSpec, target: str) -> list[Any]:
    """The joints called ``target``, all for ``"*"``, or those that actuators act on for ``"actuated"``.

    Raises:
        ValueError: if there is none; it lists the model's joints.
    """
    names = [j.name for j in spec.joints]
    if target != ACTUATED or ACTUATED in names:
        found = find_elements(spec, "joints", target)
        return [j for j in found if target != "*" or not j.name.endswith(PLAY_SUFFIX)]
    driven = names_of_joints_of_actuators(spec)
    found = [j for j in spec.joints if j.name in driven]
    if not found:
        raise ValueError(f"no actuator of the model acts on a joint; its joints: {', '.join(names) or 'none'}")
    return found
