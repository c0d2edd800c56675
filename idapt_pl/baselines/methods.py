"""The methods that ``idapt fit`` runs, by their names in a config."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from idapt_pl.baselines.correspondence import ImageCorrespondence, StateCorrespondence
from idapt_pl.baselines.oracle import train_oracle
from idapt_pl.baselines.source_only import SourceOnly
from idapt_pl.grounding import IterativeGrounding


class Method(Protocol):
    """What a run does."""

    def run(self) -> list[dict]:
        """Do it, or what is left of it. Returns what was measured after every step (``evaluation.json``)."""


@dataclass(frozen=True)
class OracleAlone:
    """The oracle in place of the method: the upper bound as a run of its own."""

    grounding: IterativeGrounding

    def run(self) -> list[dict]:
        """Train and measure it. There are no grounding steps to tell of."""
        train_oracle(self.grounding)
        return []


def itself(grounding: IterativeGrounding) -> Method:
    """Algorithm 1."""
    return grounding


METHODS: dict[str, Callable[[IterativeGrounding], Method]] = {
    "idapt": itself,
    "source": SourceOnly,
    "oracle": OracleAlone,
    "cc_state": StateCorrespondence,
    "cc_image": ImageCorrespondence,
}
"""What is done with the settings of a run."""
