"""IDAPT: transfer a visual policy to a target that looks and moves differently."""

import os
from typing import Any

# Both must be set before mujoco loads its GL backend, hence here. LP_NUM_THREADS=0 stops the software
# rasteriser from starting a thread per core, which would fight the learner and is slower for small images.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")


def _flush_denormals(torch: Any) -> None:
    """Adam's moments of idle units decay to denormal numbers, over which Intel takes a quarter of SAC's time.

    Set as soon as there is torch, as threads take this from the one that starts them.
    """
    torch.set_flush_denormal(True)


if "IDAPT_ONLY_RENDERS" not in os.environ:  # such a process has no tensors
    import wrapt

    import datamodules  # noqa: F401  prepares torchvision
    from idapt_pl.memory import keep_freed_memory

    keep_freed_memory()
    wrapt.register_post_import_hook(_flush_denormals, "torch")  # which not all that is here needs to load
