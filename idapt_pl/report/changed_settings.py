"""Values to set in a model's MJCF, in its own words: element, name, attribute, old, new, interval."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.diagnosis.answer.repaired import RepairedModel, model_as_mjcf
from idapt_pl.diagnosis.answer.result import EffectEstimate
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.effects.wording import format_estimate, format_number
from idapt_pl.prediction.simulator import Effects

NOT_SET = "not set"
LEFT_ALONE = ("compiler", "mesh", "texture", "material", "size", "statistic", "visual")
"""Elements that say where files are, or how things look."""

Place = tuple[str, str]
"""Element and name."""


@dataclass(frozen=True)
class ChangedSetting:
    """One attribute of one element.

    Attributes:
        element: MJCF's word for it.
        name: its own, or that of the body it belongs to.
        attribute: MJCF's word for it.
        old: as in the nominal model.
        new: as in the repaired one.
        interval: 95 %, from the intervals of what was found; empty where there is none.
    """

    element: str
    name: str
    attribute: str
    old: str
    new: str
    interval: str = ""


def changed_settings(diagnosis: Diagnosis, repaired: RepairedModel, folder: Path) -> list[ChangedSetting]:
    """Everything that differs between the nominal and the repaired model, with intervals.

    An attribute's interval is between its values where each parameter found is at either end of its own interval.
    """
    before, after = attributes_of(repaired.nominal), attributes_of(repaired.patched)
    ends = [attributes_of(model_with(diagnosis, effects, folder)) for effects in effects_at_ends(diagnosis)]
    made = []
    for place, new in after.items():
        old = before.get(place)
        if old is None:
            told = " ".join(f'{k}="{v}"' for k, v in new.items() if k != "name")
            made.append(ChangedSetting(*place, "(new element)", NOT_SET, told))
            continue
        for attribute, value in new.items():
            if value != old.get(attribute):
                others = [e[place].get(attribute, value) for e in ends if place in e]
                made.append(ChangedSetting(*place, attribute, old.get(attribute, NOT_SET), value, span(value, others)))
        made += [ChangedSetting(*place, a, old[a], NOT_SET) for a in old if a not in new]
    return made


def span(value: str, others: Sequence[str]) -> str:
    """The interval that an attribute's values at the ends make, as in "0.1 to 0.2"; empty where they are all one."""
    try:
        every = np.array([[float(x) for x in v.split()] for v in (value, *others)])
    except ValueError:
        return ""
    low, high = every.min(0), every.max(0)
    if np.array_equal(low, high):
        return ""
    ends = zip(every[0], low, high, strict=True)
    text = [format_estimate(v, (a, b))[1] if a != b else format_number(a, 4) for v, a, b in ends]
    return ", ".join(text)


def effects_at_ends(diagnosis: Diagnosis) -> Iterator[Effects]:
    """All effects of the repaired model, with one parameter after the other at either end of its interval."""
    for k, effect in enumerate(diagnosis.effects):
        own = [e for e in diagnosis.result.effects if e.key == (effect.name, effect.target)]
        found = next((e for e in own if all(getattr(effect, name) is not None for name in e.parameters)), None)
        for name, low_or_high in ends_of(found) if found and effect not in diagnosis.declared else ():
            try:
                changed: Any = {name: low_or_high}
                moved = replace(effect, **changed)
            except ValueError:  # an end outside the bounds of the effect
                continue
            yield (*diagnosis.effects[:k], moved, *diagnosis.effects[k + 1 :])


def ends_of(found: EffectEstimate) -> Iterator[tuple[str, float]]:
    """Parameters with an interval, and its ends."""
    for name, p in found.parameters.items():
        for end in p.ci95 or ():
            yield name, float(end)


def model_with(diagnosis: Diagnosis, effects: Effects, folder: Path) -> str:
    """The MJCF of the nominal model with effects."""
    spec = diagnosis.sim.spec.copy()
    for effect in effects:
        effect.apply(spec)
    return model_as_mjcf(spec, folder)


def attributes_of(mjcf: str) -> dict[Place, dict[str, str]]:
    """Attributes of every element of a model, by element and name; what has no name is told by its body and number."""
    found: dict[Place, dict[str, str]] = {}

    def walk(element: ET.Element, owner: str) -> None:
        count: dict[str, int] = {}
        for child in element:
            if child.tag in LEFT_ALONE:
                continue
            k = count[child.tag] = count.get(child.tag, -1) + 1
            named = child.get("name") or child.get("class") or (f"{owner}[{k}]" if k or child.tag == "geom" else owner)
            found[child.tag, named] = dict(child.attrib)
            walk(child, child.get("name") or owner)

    walk(ET.fromstring(mjcf), "")
    return found
