"""IDAPT: transfer a visual policy to a target that looks and moves differently."""

import os

# Both must be set before mujoco loads its GL backend, hence here. LP_NUM_THREADS=0 stops the software
# rasteriser from starting a thread per core, which would fight the learner and is slower for small images.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")


def _flush_denormals() -> None:
    """Adam's moments of idle units decay to denormal numbers, over which Intel takes a quarter of SAC's time.

    Set as soon as there is torch, as threads take this from the one that starts them.
    """
    import torch

    torch.set_flush_denormal(True)


if "IDAPT_ONLY_RENDERS" not in os.environ:  # such a process has no tensors
    from datamodules.once_loaded import once_loaded
    from idapt_pl.memory import keep_freed_memory

    keep_freed_memory()
    once_loaded("torch", _flush_denormals)  # which takes seconds to load, and not all that is here needs it
