"""Lets torchvision be imported beside a CPU-only torch that its compiled operators do not load with.

There is no CPU build of torchvision for every platform. The default build then cannot load its compiled
operators, and importing it fails on registering shape functions for two of them. Declaring the two
operators (no implementation) lets the rest work: transforms, models, make_grid, save_image. Where the
compiled operators load, this does nothing. Importing Lightning imports torchvision, so it comes first:
as soon as torch is loaded.
"""

from __future__ import annotations

import sys
from typing import Any

_DECLARED: list[Any] = []  # a Library is undone when it is collected


def ensure_torchvision(torch: Any) -> None:
    """Import torchvision, declaring its missing operators where that is what stops it; torch is there by then."""
    try:
        import torchvision
    except RuntimeError as error:
        if "torchvision::nms" not in str(error):
            raise
        for name in [m for m in sys.modules if m == "torchvision" or m.startswith("torchvision.")]:
            del sys.modules[name]
        library = torch.library.Library("torchvision", "DEF")
        library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.define(
            "qnms(Tensor dets, Tensor scores, float iou_threshold, float dets_scale, int dets_zero_point) -> Tensor"
        )
        _DECLARED.append(library)
        import torchvision  # noqa: F401
