"""Freed memory is kept for the next tensor: the C library's allocator, told so."""

from __future__ import annotations

import ctypes
import gc
import os
import sys

import psutil

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names and numbers of glibc's malloc.h."""
KEPT = 2**30
"""Bytes: smaller blocks come from the heap, and this much of its free end stays with the process."""
MUCH = 2 * 2**30
"""Bytes that a process may have before it is tidied between stages."""


def keep_freed_memory() -> bool:
    """Have glibc keep what is freed rather than give it back to the system. Returns whether it could be told.

    Tensors of megabytes are otherwise mapped anew each time, and the system clears every page of them first: a
    fifth of a training step of the state predictors on a CPU (``benchmarks/state_predictor.py``). Where memory is
    scarce, the environment variable ``IDAPT_KEEP_MEMORY=0`` leaves the allocator as it is.
    """
    if not sys.platform.startswith("linux") or os.environ.get("IDAPT_KEEP_MEMORY") == "0":
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
    return mallopt is not None and all(mallopt(option, KEPT) for option in (M_MMAP_THRESHOLD, M_TRIM_THRESHOLD))


def tidy_memory() -> None:
    """Between stages: what is no longer used goes back to the system, if the process has much.

    A Trainer, its data and its module refer to one another, so they wait for Python's collector. Eight grounding steps
    of Walker2d had grown to 8 GB without it.
    """
    if psutil.Process().memory_info().rss < MUCH:
        return
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform.startswith("linux") else None
    if trim is not None:
        trim(0)
