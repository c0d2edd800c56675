"""How fast do frame stacks come out of trajectory files?

Run ``python benchmarks/loading.py``; it prints a table and writes ``results/loading.csv``. ``first_read_s``
is opening, decompressing and checking the two files of :class:`datamodules.UnpairedImages`;
``batches_per_second`` is random access after that, a batch being that many frame stacks of each domain.
Rates are medians of several timed runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported

# isort: split
from rendering import SIZES, rate, write_table

from datamodules import UnpairedImages, write_trajectories
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rl.collect import collect
from idapt_pl.rl.exploration import random_policy
from idapt_pl.tasks import make_task

TASK = "inverted_pendulum"

STEPS = 5000
BATCHES = 100_000  # an epoch that no run exhausts
SEED = 0


def record(folder: Path, size: int) -> tuple[Path, Path]:
    """Trajectory files of the source and the hard target with random actions."""
    task, paths = make_task(TASK), []
    for domain in ("source", "hard"):
        path = folder / f"{domain}_{size}.h5"
        with closing(VectorImageEnv(task, task.domain(domain), 1, size, frame_stack=1)) as env:
            write_trajectories(path, collect(env, random_policy(env, SEED), STEPS, SEED, "benchmark"))
        paths.append(path)
    return paths[0], paths[1]


def main() -> None:
    """Measure everything."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for size in SIZES:
            source, target = record(Path(folder), size)
            for batch in (4, 8, 32):
                data = UnpairedImages([source], [target], 3, batch, BATCHES, SEED)
                started = time.perf_counter()
                data.setup("fit")
                first_read = round(time.perf_counter() - started, 2)
                batches = iter(data.train_dataloader())
                what = {"image_size": size, "batch": batch, "frames_per_file": len(data.source_data)}
                speed = {"first_read_s": first_read, "batches_per_second": rate(partial(next, batches))}
                rows.append(what | {"megabytes_per_file": round(source.stat().st_size / 1e6, 1)} | speed)
    write_table("loading", rows)


if __name__ == "__main__":
    main()
