"""What Filament keeps in memory of every frame, and what is left of it where its process is replaced.

    python benchmarks/filament_memory.py

Draws Fetch-Reach's hard domain, the same state again and again, first by Filament in this process, then by
``ParallelRenderer``, whose process is replaced after ``LIFETIME`` frames. Writes ``results/filament_memory.csv``:
``mb_per_frame`` is the growth of this process from the first frame after a warm-up to the last; ``mb_here`` and
``mb_there`` are the most that this process and the one that draws for it held (resident).
"""

from __future__ import annotations

import argparse
import os
from contextlib import closing
from pathlib import Path

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported

# isort: split
import mujoco
import numpy as np
from rendering import write_table

from idapt_pl.rendering import parallel
from idapt_pl.rendering.filament import FilamentRenderer, why_unavailable
from idapt_pl.rendering.parallel import FRAMES_PER_PROCESS, ParallelRenderer
from idapt_pl.tasks import make_task

WARM_UP = 100


def resident(pid: int) -> float:
    """Memory of a process in MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def measure(size: int, frames: int, replaced: bool) -> dict:
    """Draw frames and watch the memory."""
    task = make_task("fetch_reach")
    model = task.domain("hard").compile()
    data = mujoco.MjData(model)
    task.reset(model, data, np.random.default_rng(0))
    mujoco.mj_forward(model, data)
    here, there = [], [0.0]
    with closing(ParallelRenderer(model, size) if replaced else FilamentRenderer(model, size)) as render:
        for _ in range(WARM_UP + frames):
            render([data]) if replaced else render(data)
            here.append(resident(os.getpid()))
            there += [resident(p._process.pid) for p in parallel._others["filament"]] if replaced else []
    row = {
        "image_size": size,
        "frames": frames,
        "process": f"replaced after {FRAMES_PER_PROCESS}" if replaced else "this one",
    }
    row |= {"mb_per_frame": round((here[-1] - here[WARM_UP]) / frames, 3)}
    return row | {"mb_here": round(max(here)), "mb_there": round(max(there))}


def main() -> None:
    """Measure."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--sizes", type=int, nargs="+", default=[64, 100])
    p.add_argument("--frames", type=int, default=2 * FRAMES_PER_PROCESS)
    o = p.parse_args()
    if why := why_unavailable():
        raise SystemExit(why)
    rows = [measure(size, o.frames, replaced) for replaced in (True, False) for size in o.sizes]
    write_table("filament_memory", rows)


if __name__ == "__main__":
    main()
