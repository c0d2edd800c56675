"""How fast are frames rendered, and environments stepped?

Run ``python benchmarks/rendering.py``; it prints a table and writes ``results/rendering.csv``. Rates are
medians of several timed runs.
"""

from __future__ import annotations

import csv
import os
import platform
import statistics
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported

# isort: split
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from idapt_pl.domains.rendering import FrameRenderer
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rollout import random_policy
from idapt_pl.tasks import make_task

TASK = "inverted_pendulum"
SIZES = (64, 100)
RESULTS = Path(__file__).parents[1] / "results"


def machine() -> dict[str, str | int]:
    """The columns that say where a row was measured."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return {"cpu": models[0] if models else platform.machine(), "cores": os.cpu_count()}


def rate(action: Callable[[], None], seconds: float = 1.0, runs: int = 5) -> float:
    """Calls per second: the median of ``runs`` runs of about ``seconds`` each."""
    action()  # first calls allocate
    rates = []
    for _ in range(runs):
        calls, started = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - started) < seconds:
            action()
            calls += 1
        rates.append(calls / elapsed)
    return round(statistics.median(rates), 1)


def write_table(name: str, rows: list[dict]) -> None:
    """Print rows and write them to ``results/<name>.csv``, with the machine in the last columns."""
    table = Table(*rows[0], title=name)
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console().print(table)
    where = machine()
    with open(RESULTS / f"{name}.csv", "w", newline="") as f:
        writer = csv.DictWriter(f, [*rows[0], *where], lineterminator="\n")
        writer.writeheader()
        writer.writerows(row | where for row in rows)


def frames_per_second(domain: str, size: int) -> float:
    """Frames/s of one renderer on still images."""
    model = make_task(TASK).domain(domain).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    render, out = FrameRenderer(model, size), np.zeros((size, size, 3), np.uint8)
    with closing(render):
        return rate(lambda: render(data, out))


def steps_per_second(num_envs: int, size: int) -> float:
    """Control steps/s of all simulations together, physics and images, random actions."""
    task = make_task(TASK)
    with closing(VectorImageEnv(task, task.domain("source"), num_envs, size)) as env:
        policy = random_policy(env, seed=0)
        obs, _ = env.reset(seed=0)
        return num_envs * rate(lambda: env.step(policy(obs["pixels"])))


def main() -> None:
    """Measure everything."""
    rows = []
    for size in SIZES:
        for domain in ("source", "easy", "hard"):
            what = {"what": "frames", "domain": domain, "image_size": size, "num_envs": 1}
            rows.append(what | {"per_second": frames_per_second(domain, size)})
        for num_envs in (1, 4, 16):
            what = {"what": "environment steps", "domain": "source", "image_size": size, "num_envs": num_envs}
            rows.append(what | {"per_second": steps_per_second(num_envs, size)})
    write_table("rendering", rows)


if __name__ == "__main__":
    main()
