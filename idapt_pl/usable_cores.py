"""How many cores a process may use: its affinity, which schedulers and containers set, says it."""

from __future__ import annotations

import os

import psutil


def usable_cores() -> int:
    """Cores that this process may use."""
    process = psutil.Process()
    return len(process.cpu_affinity()) if hasattr(process, "cpu_affinity") else (os.cpu_count() or 1)
