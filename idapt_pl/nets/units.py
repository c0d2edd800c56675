"""Linear layers whose inputs or outputs are told in other units, so that a net goes on computing what it did."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Units:
    """What quantities are standardised by: (x - mean) / std, both (s,)."""

    mean: Float[Tensor, " s"]
    std: Float[Tensor, " s"]

    @classmethod
    def of(cls, standardised: torch.nn.Module) -> Units:
        """Those that a module has now, as its buffers ``mean`` and ``std``."""
        return cls(standardised.mean.clone(), standardised.std.clone())

    @property
    def of_differences(self) -> Units:
        """Those of what is added to a standardised quantity."""
        return Units(torch.zeros_like(self.mean), self.std)

    def repeated(self, times: int) -> Units:
        """Of so many of them in a row."""
        return Units(self.mean.repeat(times), self.std.repeat(times))


@torch.no_grad()
def take_in_units(weight: Float[Tensor, "h s"], bias: Float[Tensor, " h"], before: Units, now: Units) -> None:
    """Change a layer, in place: what it takes is standardised by ``now``, and by ``before`` so far.

    Args:
        weight: of those inputs; a view of a layer's columns will do.
        bias: of the layer.
        before: units so far.
        now: units from now on.
    """
    bias += weight @ ((now.mean - before.mean) / before.std)
    weight *= now.std / before.std


@torch.no_grad()
def give_in_units(weight: Float[Tensor, "s h"], bias: Float[Tensor, " s"], before: Units, now: Units) -> None:
    """Change a layer, in place: what it gives is standardised by ``now``, and by ``before`` so far."""
    ratio = before.std / now.std
    weight *= ratio[:, None]
    bias *= ratio
    bias += (before.mean - now.mean) / now.std
