"""IDAPT: transfer a visual policy to a target that looks and moves differently."""

import os

# Both must be set before mujoco loads its GL backend, hence here. LP_NUM_THREADS=0 stops the software
# rasteriser from starting a thread per core, which would fight the learner and is slower for small images.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")

if "IDAPT_ONLY_RENDERS" not in os.environ:  # such a process needs no torch, which takes seconds to load
    import torch

    from datamodules.torchvision_compat import ensure_torchvision
    from idapt_pl.memory import keep_freed_memory

    ensure_torchvision()  # before anything imports Lightning
    keep_freed_memory()
    # Adam's moments of idle units decay to denormal numbers, over which Intel takes a quarter of SAC's time.
    # Set here, as threads take this from the one that starts them.
    torch.set_flush_denormal(True)
