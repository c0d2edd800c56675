"""What differs between the domains of a task, read from the compiled models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.differences import Difference, differences
from idapt_pl.tasks import Task

LISTED_ELEMENTS = 6
"""Elements of one kind that are all named; of more, how many there are."""


@dataclass(frozen=True)
class DomainDifference:
    """A field in which domains differ from the source.

    Attributes:
        field: of the compiled model, or an effect that MJCF has no words for.
        element: MJCF name, or several.
        visual: whether it is only seen.
        values: domain to its value, of the source and of the domains that differ.
    """

    field: str
    element: str
    visual: bool
    values: dict[str, Any]


def effects_beyond_mjcf(domain: Domain) -> list[Difference]:
    """The domain's effects that its model cannot show, since MJCF has no words for them."""
    told = [e.to_dict() for e in domain.beyond_mjcf]
    return [Difference(e["effect"], e["target"], "none", e["parameters"]) for e in told]


def compare_domains(task: Task) -> list[DomainDifference]:
    """Every field of every element in which a domain differs from the source."""
    domains = task.domains()
    models = {name: domain.compile() for name, domain in domains.items()}
    rows: dict[tuple[str, str], DomainDifference] = {}
    for name in (n for n in domains if n != "source"):
        for d in differences(models["source"], models[name]) + effects_beyond_mjcf(domains[name]):
            new = DomainDifference(d.field, d.element, d.visual, {"source": d.before})
            rows.setdefault((d.field, d.element), new).values[name] = d.after
    return list(rows.values())


def group_differences(rows: list[DomainDifference]) -> list[DomainDifference]:
    """Rows of one field with the same values put together, values as text."""
    groups: dict[tuple, list[str]] = {}
    for d in rows:
        values = tuple((domain, describe_value(value, d.element)) for domain, value in d.values.items())
        groups.setdefault((d.field, d.visual, values), []).append(d.element)
    return [
        DomainDifference(field, list_elements(elements), visual, dict(values))
        for (field, visual, values), elements in groups.items()
    ]


def list_elements(names: list[str]) -> str:
    """Names one after the other; of many, how many there are and the first."""
    if len(names) <= LISTED_ELEMENTS:
        return ", ".join(names)
    return f"{len(names)}: {', '.join(names[:3])}, ..."


def describe_value(value: Any, element: str) -> str:
    """A value of an element for a reader: ``-`` if it is not there, ``present`` if all that is known is its name."""
    if value is None:
        return "-"
    return "present" if isinstance(value, str) and value == element else format_value(value)


def format_value(value: Any) -> str:
    """A value for a reader: four digits, arrays in brackets without zeros at their end."""
    if isinstance(value, dict):
        return ", ".join(f"{k} {format_value(v)}" for k, v in value.items())
    if isinstance(value, np.ndarray) and value.ndim:
        rounded = np.where(np.abs(value) < 1e-9, 0.0, value).ravel()
        kept = rounded if value.size <= 4 else np.trim_zeros(rounded, "b")
        return "(" + ", ".join(f"{v:.4g}" for v in kept) + ")" if kept.size else "0"
    return f"{float(value):.4g}" if isinstance(value, int | float | np.number | np.ndarray) else str(value)
