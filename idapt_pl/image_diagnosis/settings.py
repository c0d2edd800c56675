"""Whether and how the loop looks for effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from idapt_pl.effects import EFFECTS
from idapt_pl.ranges import Range, check_ranges

SHORTEST_EPISODE = 6
"""Control steps that an episode must last to be of use."""
DEFAULT_CANDIDATES = (
    "body_mass",
    "joint_damping",
    "joint_frictionloss",
    "joint_armature",
    "actuator_gain",
    "actuator_delay",
)
"""What is looked for by default: what an environment can be given, and what so poor a sensor can tell apart."""


@dataclass(frozen=True)
class DiscoverySettings:
    """Whether and how the loop looks for effects that the source lacks.

    Args:
        discover: look for them and add what is found to the source.
        candidates: names of the effects to consider.
        max_effects: stop after so many in a grounding step.
        looks: before anything is learned, look for visual effects (camera, lamps, colours, sky, blur) in the first
            frames of the target's episodes, and add what is found to the source. Episodes must begin alike in both.
        refine: where states tell positions, look instead for the effects, with their parameters, that let simulations
            from known starts forecast the target's first frames best. Episodes must begin alike in both.
        every_step: look again in every grounding step; False looks in the task-agnostic data alone.
        known: effects that the source lacks as is known already: a file such as the ``effects.yaml`` of ``idapt
            diagnose``, or its content. They are added before anything is learned.
    """

    discover: bool = False
    candidates: tuple[str, ...] = DEFAULT_CANDIDATES
    max_effects: int = 2
    looks: bool = False
    refine: bool = False
    every_step: bool = True
    known: str | list[dict[str, Any]] | None = None

    def __post_init__(self) -> None:
        check_ranges("effects", vars(self), {"max_effects": Range(1, 100)})
        if unknown := [name for name in self.candidates if name not in EFFECTS]:
            raise ValueError(f"effects.candidates: unknown effect {unknown[0]!r}; effects are: {', '.join(EFFECTS)}")
