"""How long does a state predictor train on a batch, by memory allocator and memory layout? On one CPU thread.

    python benchmarks/state_predictor.py [--rounds 5]

Every figure is the median of rounds in processes of their own, taken in turns. ``allocator``: glibc as it comes, or
told to keep freed memory (:mod:`idapt_pl.memory`); ``layout``: of convolutions' weights. The last of each is what
``idapt`` does. Writes results/state_predictor.csv.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

ALLOCATORS, LAYOUTS = ("as it comes", "keeps"), ("channels first", "channels last")
CONFIGS = ("pendulum_quick", "cheetah_quick", "fetch_quick", "walker_hard+presets/paper")
BATCH, WARM_UP, STEPS = 32, 4, 15
KEY = ("config", "allocator", "layout")


def measure(config: str, layout: str) -> float:
    """Median time of a training step, s, in this process."""
    import idapt_pl  # noqa: F401, I001  tells the allocator
    import mujoco
    import torch
    import yaml

    from idapt_pl.nets.encoder import Vision
    from idapt_pl.nets.images import stack_channels
    from idapt_pl.tasks import make_task

    torch.set_num_threads(1)
    settings: dict = {}
    for name in config.split("+"):
        settings |= yaml.safe_load((ROOT / f"configs/{name}.yaml").read_text())
    task, size = make_task(settings["task"]), settings.get("image_size", 100)
    vision = Vision(**settings.get("vision", {}))
    model = task.domain("source").compile()
    state_dim = len(task.state(model, mujoco.MjData(model)))
    P = vision.predictor(size, 3, state_dim, task.rates, dt=0.04)
    P.to(memory_format=torch.channels_last if layout == "channels last" else torch.contiguous_format)
    images = stack_channels(torch.randint(0, 255, (BATCH, 3, size, size, 3), dtype=torch.uint8))
    states, optimizer, times = torch.randn(BATCH, state_dim), torch.optim.Adam(P.parameters(), fused=True), []
    for _ in range(WARM_UP + STEPS):
        started = time.perf_counter()
        optimizer.zero_grad()
        P.error(images, states).backward()
        optimizer.step()
        times.append(time.perf_counter() - started)
    return statistics.median(times[WARM_UP:])


def main() -> None:
    """Measure in turns and keep the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=5)
    p.add_argument(
        "--configs",
        nargs="+",
        default=CONFIGS,
        help="in configs/, without .yaml; + lays one over another",
    )
    p.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    o = p.parse_args()
    if o.one:
        print(json.dumps(measure(*o.one)))
        return
    from rendering import write_table  # not before: it imports idapt_pl

    for config in o.configs:
        cases = list(itertools.product(ALLOCATORS, LAYOUTS))
        times: dict[tuple[str, str], list[float]] = {case: [] for case in cases}
        for _, case in itertools.product(range(o.rounds), cases):
            keep = {"IDAPT_KEEP_MEMORY": str(ALLOCATORS.index(case[0]))}
            command = [sys.executable, __file__, "--one", config, case[1]]
            done = subprocess.run(command, env=os.environ | keep, check=True, stdout=subprocess.PIPE, text=True)
            times[case].append(json.loads(done.stdout))
        medians = {case: statistics.median(t) for case, t in times.items()}
        rows = [
            {"config": config, "allocator": case[0], "layout": case[1], "step_ms": round(1e3 * t, 1),
             "times_first": round(medians[cases[0]] / t, 2)}
            for case, t in medians.items()
        ]  # fmt: skip
        print(*rows, sep="\n", flush=True)
        write_table("state_predictor", rows, KEY)


if __name__ == "__main__":
    main()
