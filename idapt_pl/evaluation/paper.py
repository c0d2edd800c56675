"""Returns and successes that the paper reports, read off its figures, to stand beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PAPER_IMAGES, PAPER_INTERACTIONS, PAPER_GROUNDING = 20_000, 1_000, {"easy": 1, "hard": 5}
"""Target steps of the paper's IDAPT at first, in each grounding step, and how many of these there are (section V.B)."""
PAPER_CC_SAMPLES = 50_000
"""Target steps that cross-domain correspondence has there at first; then as many in each iteration as IDAPT."""
WITHOUT_TARGET = ("DR-Narrow", "DR-Wide", "Adaptive RL")

READ_OFF = {"inverted_pendulum": 4, "half_cheetah": 15, "walker2d": 10, "fetch_reach": 0.005, "sawyer_push": 0.005}
"""How precisely the figures can be read."""

PAPER_RESULTS: Mapping[tuple[str, str], Mapping[str, float]] = MappingProxyType(
    {
        ("inverted_pendulum", "easy"): {
            "DR-Narrow": 553, "DR-Wide": 387, "Adaptive RL": 13, "CC-State": 13, "CC-Image": 13, "IDAPT": 1000,
        },
        ("inverted_pendulum", "hard"): {
            "DR-Narrow": 17, "DR-Wide": 124, "Adaptive RL": 10, "CC-State": 17, "CC-Image": 13, "Visual Only": 14,
            "IDAPT": 1000,
        },
        ("half_cheetah", "easy"): {
            "DR-Narrow": 2853, "DR-Wide": 231, "Adaptive RL": -364, "CC-State": 2627, "CC-Image": 316, "IDAPT": 4001,
        },
        ("half_cheetah", "hard"): {
            "DR-Narrow": 1904, "DR-Wide": 2782, "Adaptive RL": 1464, "CC-State": 2513, "CC-Image": 458,
            "Visual Only": 590, "IDAPT": 1695,
        },
        ("walker2d", "easy"): {
            "DR-Narrow": 1013, "DR-Wide": 154, "Adaptive RL": 86, "CC-State": 221, "CC-Image": 134, "IDAPT": 2481,
        },
        ("walker2d", "hard"): {
            "DR-Narrow": 183, "DR-Wide": 96, "Adaptive RL": 77, "CC-State": 666, "CC-Image": 134, "Visual Only": 936,
            "IDAPT": 1930,
        },
        ("fetch_reach", "easy"): {
            "DR-Narrow": 0.167, "DR-Wide": 0.697, "Adaptive RL": 0.310, "CC-State": 0.171, "CC-Image": 0.083,
            "IDAPT": 0.911,
        },
        ("fetch_reach", "hard"): {
            "DR-Narrow": 0.196, "DR-Wide": 0.257, "Adaptive RL": 0.0, "CC-State": 0.133, "CC-Image": 0.13,
            "Visual Only": 0.167, "IDAPT": 0.874,
        },
        ("sawyer_push", "easy"): {
            "DR-Narrow": 1.0, "DR-Wide": 0.646, "Adaptive RL": 0.297, "CC-State": 0.066, "CC-Image": 0.0, "IDAPT": 1.0,
        },
        ("sawyer_push", "hard"): {
            "DR-Narrow": 0.0, "DR-Wide": 0.0, "Adaptive RL": 0.0, "CC-State": 0.297, "CC-Image": 0.0,
            "Visual Only": 0.02, "IDAPT": 0.736,
        },
    }
)  # fmt: skip
"""(task, target) to method to its mean over seeds (three or five) of 100 episodes: the bars of the comparison. For
``Visual Only``, which has target-hard alone, the last grounding step of its curve."""


def unlike_the_paper(task: str, target: str, method: str, target_steps: float) -> list[str]:
    """Why a figure of the paper and one of ours are not like for like.

    Args:
        task: of the cell.
        target: of the cell.
        method: the paper's name for it.
        target_steps: control steps in the target that ours took.
    """
    found = steps_differ(method, target, target_steps)
    if target == "hard" and task in ("fetch_reach", "sawyer_push"):
        found.append("scenes of Unity there")
    if method.startswith("CC"):
        found.append("its checkpoints were chosen by return in the target")
    if method == "CC-State":
        found.append("it acts on the target's true states there")
    if method == "CC-Image":
        found.append("a policy of states there, which are read of images")
    return [*found, f"read off a figure, ± {READ_OFF[task]:g}"]


def paper_steps(method: str, target: str) -> int:
    """Control steps in the target that the paper's figure of a method took."""
    if method in WITHOUT_TARGET:
        return 0
    first = PAPER_CC_SAMPLES if method.startswith("CC") else PAPER_IMAGES
    return first + PAPER_GROUNDING[target] * PAPER_INTERACTIONS


def steps_differ(method: str, target: str, target_steps: float) -> list[str]:
    """The budgets, where they differ."""
    there = paper_steps(method, target)
    return [f"{there:,} target steps there, {target_steps:,.0f} here"] if there != round(target_steps) else []
