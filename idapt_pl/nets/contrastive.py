"""Patch features for the one-sided contrastive loss (CUT, Park et al. 2020, sec. 3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.nets.mlp import mlp


class PatchProjector(nn.Module):
    """H: a small MLP for each chosen layer of G, from the activations at some places to unit vectors.

    Args:
        channels: of the layers' activations.
        features: size of the vectors.
        patches: places looked at in each layer (all of them where there are fewer).
    """

    def __init__(self, channels: Sequence[int], features: int = 256, patches: int = 256) -> None:
        super().__init__()
        self.heads = nn.ModuleList(mlp(c, [features], features) for c in channels)
        self.patches = patches

    def forward(self, activations: Sequence[Tensor], others: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
        """For each layer, the vectors (B, P, D) of two images' activations (B, C, H, W) at the same random places."""
        pairs = []
        for head, a, b in zip(self.heads, activations, others, strict=True):
            places = torch.randperm(a.shape[-2] * a.shape[-1], device=a.device)[: self.patches]
            pairs.append(tuple(nnf.normalize(head(x.flatten(2)[..., places].mT).float(), dim=-1) for x in (a, b)))
        return pairs
