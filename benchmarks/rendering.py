"""How fast are frames rendered, and environments stepped?

    python benchmarks/rendering.py [--task half_cheetah ...]

Prints a table and writes ``results/rendering.csv``, where other tasks' rows stay. Rates are medians of several timed
runs. Domains that Filament draws are measured with the classic renderer too. ``processes`` are those that render.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported

# isort: split
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from tables import replace_rows, write_rows

from idapt_pl.effects.visual import engine_of
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.rendering.classic import FrameRenderer
from idapt_pl.rendering.filament import FilamentRenderer
from idapt_pl.rendering.make import filament_is_used
from idapt_pl.rendering.parallel import usual_processes
from idapt_pl.rl.exploration import random_policy
from idapt_pl.tasks import TASKS, make_task

SIZES = (64, 100)
RESULTS = Path(__file__).parents[1] / "results"


def machine() -> dict[str, str | int]:
    """The columns that say where a row was measured."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return {"cpu": models[0] if models else platform.machine(), "cores": os.cpu_count()}


def rate(action: Callable[[], None], seconds: float = 0.5, runs: int = 3) -> float:
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


def write_table(name: str, rows: list[dict], key: Sequence[str] = ()) -> None:
    """Print rows and write them to ``results/<name>.csv``, with the machine in the last columns.

    With a ``key``, rows that are there stay if they differ from all new ones in it.
    """
    table = Table(*rows[0], title=name)
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console().print(table)
    where = machine()
    path, rows = RESULTS / f"{name}.csv", [row | where for row in rows]
    replace_rows(path, rows, key) if key else write_rows(path, rows)


def frames_per_second(task: str, domain: str, size: int) -> list[dict]:
    """Frames/s of still images, for each renderer that the domain may be drawn by."""
    model = make_task(task).domain(domain).compile()
    data = mujoco.MjData(model)
    make_task(task).reset(model, data, np.random.default_rng(0))
    mujoco.mj_forward(model, data)
    renderers = {"classic": FrameRenderer}
    if engine_of(model) == "filament" and filament_is_used():
        renderers["filament"] = FilamentRenderer
    rows, out = [], np.zeros((size, size, 3), np.uint8)
    for name, renderer in renderers.items():
        with closing(renderer(model, size)) as render:
            rows.append({"renderer": name, "per_second": rate(lambda render=render: render(data, out))})
    return rows


def steps_per_second(env: VectorImageEnv) -> float:
    """Control steps/s of all simulations together, with random actions."""
    policy = random_policy(env, seed=0)
    obs, _ = env.reset(seed=0)
    return env.num_envs * rate(lambda: env.step(policy(obs["pixels"])))


def measure(name: str) -> list[dict]:
    """All rates of one task."""
    task, rows = make_task(name), []
    columns = {"task": name, "domain": "source", "image_size": 0, "num_envs": 1, "renderer": "none", "processes": 1}
    columns |= {"per_second": 0.0}
    for size in SIZES:
        for domain in ("source", "easy", "hard"):
            what = {"what": "frames"} | columns | {"domain": domain, "image_size": size}
            rows += [what | found for found in frames_per_second(name, domain, size)]
    envs = [({"image_size": 0}, VectorStateEnv(task, task.domain("source"), 1))]
    for num_envs, others in ((1, 0), (4, 0), (4, usual_processes()), (16, 0), (16, usual_processes())):
        about = {"image_size": 64, "num_envs": num_envs, "renderer": "classic", "processes": 1 + others}
        env = VectorImageEnv(task, task.domain("source"), num_envs, 64, render_processes=others)
        envs.append((about, env))
    for about, env in envs:
        with closing(env):
            rows.append({"what": "environment steps"} | columns | about | {"per_second": steps_per_second(env)})
    return rows


def main() -> None:
    """Measure everything."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--task", choices=TASKS, nargs="+", default=list(TASKS))
    rows = [row for name in p.parse_args().task for row in measure(name)]
    write_table("rendering", rows, key=("task",))


if __name__ == "__main__":
    main()
