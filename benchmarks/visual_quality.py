"""Does state reconstruction make translations better? With and without it, by task, target and seed.

    python benchmarks/visual_quality.py [--tasks inverted_pendulum walker2d] [--targets easy hard] [--seeds 0 1 2]

Trains ``idapt visual``, preset ``fast``, on recordings of babbling, for a thousand batches. Writes
``results/visual_quality.csv``, a row a run, as runs finish (rows that are there are not repeated). Below
runs/visual_quality/ each run keeps its picture, ``quality.png``. Columns, all on images of states not trained on:

- ``psnr``, ``ssim``: of G(o) against the target's image of the same state; ``_before``: of the source's image.
- ``state_error``: of P^T on G(o), mean absolute, in units of the states' spread; P^T is P^S without reconstruction.
- ``state_error_probe``: of a probe trained on labelled images of the target (used for nothing else) on G(o);
  ``state_error_probe_floor``: on the target's own images, what a perfect G would have.
- ``kid``, ``kid_before``, ``kid_floor``: see cli/visual_quality.py.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import numpy as np
from rendering import machine
from tables import read_rows, write_rows

from cli.main import main as idapt
from cli.provenance import git_commit
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.effects import View
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rl.exploration import babbling_policy
from idapt_pl.tasks import make_task

OUT = ROOT / "results" / "visual_quality.csv"
SIZE = 64
VIEWS = {"inverted_pendulum": View(share=0.64, up=0.12), "walker2d": View()}
MEASURED = ("psnr", "psnr_before", "ssim", "ssim_before", "state_error", "state_error_probe", "state_error_probe_floor")
MEASURED += ("kid", "kid_before", "kid_floor")
KEYS = ("task", "target", "state_weight", "state_jitter", "background", "seed")


def paired_recordings(task_name: str, target: str, steps: int, seed: int) -> tuple[Trajectories, Trajectories]:
    """An exploration of the source with states, and the same states as the target shows them."""
    task, view = make_task(task_name), VIEWS[task_name]
    env, twin = (VectorImageEnv(task, task.domain(name), 1, SIZE, 1, view) for name in ("source", target))
    with closing(env), closing(twin):
        act, (obs, _) = babbling_policy(env, seed), env.reset(seed=seed)
        episodes: tuple[list, list] = ([], [])
        rows: list[tuple] = []
        for step in range(steps):
            action = act(obs["pixels"])
            rows.append((obs["pixels"][0, -1].copy(), twin.show(0, env.data[0]), obs["state"][0].copy(), action[0]))
            obs, _, ended, cut, _ = env.step(action)
            if ended[0] or cut[0] or step == steps - 1:
                if len(rows) > 1:  # the last action's outcome is of no use here
                    for kept, episode in zip(episodes, as_episodes(rows), strict=True):
                        kept.append(episode)
                rows = []
        return tuple(Trajectories(tuple(kept), env.dt, "benchmark") for kept in episodes)


def as_episodes(rows: list[tuple]) -> tuple[Episode, Episode]:
    """One episode as the source and as the target shows it."""
    source, target, states, actions = (np.stack(column) for column in zip(*rows, strict=True))
    return tuple(Episode(actions[:-1], {"pixels": pixels, "state": states}) for pixels in (source, target))


def unlabelled(trajectories: Trajectories) -> Trajectories:
    """Images and actions only."""
    episodes = (Episode(e.actions, {"pixels": e.observations["pixels"]}) for e in trajectories)
    return Trajectories(tuple(episodes), trajectories.dt, trajectories.source)


def record(folder: Path, task: str, target: str, seed: int, images: int) -> None:
    """Training images of both domains (of different states), test pairs, and labelled target images for the probe."""
    if (folder / "probe.h5").exists():
        return
    for k, (name, n) in enumerate((("source", images), ("target", images), ("test", 500), ("probe", images))):
        source, seen = paired_recordings(task, target, n, 10 * seed + k)
        if name in ("source", "test"):
            write_trajectories(folder / f"{name}.h5", source)
        if name in ("target", "test"):
            write_trajectories(folder / f"{name}{'_target' * (name == 'test')}.h5", unlabelled(seen))
        if name == "probe":
            write_trajectories(folder / "probe.h5", seen)


def run(task: str, target: str, weight: float, seed: int, o: argparse.Namespace) -> dict:
    """Train and test once; a row of the table."""
    data = ROOT / "runs" / "visual_quality" / f"{task}_{target}_{seed}"
    folder = data / f"state_weight_{weight:g}_jitter_{o.jitter:g}{'_background' * o.background}"
    record(data, task, target, seed, o.images)
    where = {"source": "source", "target": "target", "test_source": "test", "test_target": "test_target"}
    common = [f"--data.{k}={data / v}.h5" for k, v in where.items()]
    common += ["--data.paired=true", "--data.frame_stack=3", "--data.batch_size=4", f"--run_dir={folder}"]
    common += [f"--quality.target_states={data / 'probe.h5'}", f"--quality.state_batches={o.state_batches}"]
    settings = [f"--config={ROOT / 'configs/visual/fast.yaml'}", f"--model.state_weight={weight}"]
    settings += [f"--model.state_jitter={o.jitter}", f"--model.background={o.background}"]
    settings += [f"--labelled.batches={o.state_batches}", "--labelled.lr=3e-3", f"--seed_everything={seed}"]
    settings += ["--vision.strides=[2,2,1,1]", "--vision.pool=keypoints"]
    trainer = [f"--trainer.max_epochs={o.epochs}", "--trainer.limit_val_batches=0"]
    started = time.perf_counter()
    if idapt(["visual", "fit", *settings, *common, *trainer]) or idapt(["visual", "test", *common]):
        raise SystemExit(f"{folder}: failed")
    figures = json.loads((folder / "quality.json").read_text())
    row = {"task": task, "target": target, "state_weight": weight, "state_jitter": o.jitter}
    row |= {"background": int(o.background), "seed": seed}
    row |= {name: figures.get(name) for name in MEASURED}
    return row | {"minutes": round((time.perf_counter() - started) / 60, 1), "commit": git_commit(), **machine()}


def main() -> None:
    """Run what is missing and keep the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--tasks", choices=VIEWS, nargs="+", default=list(VIEWS))
    p.add_argument("--targets", nargs="+", default=["easy", "hard"])
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--weights", type=float, nargs="+", default=[5.0, 0.0], help="of state reconstruction")
    p.add_argument("--jitter", type=float, default=0.0, help="of contrast, brightness and noise that P^T sees")
    p.add_argument("--background", action="store_true", help="generators begin as the other domain's mean image")
    p.add_argument("--images", type=int, default=4000, help="recorded of each domain")
    p.add_argument("--epochs", type=int, default=1, help="of images/4 batches")
    p.add_argument("--state_batches", type=int, default=1200, help="to fit P^S, and the probe")
    p.add_argument("--out", type=Path, default=OUT)
    o = p.parse_args()
    rows = read_rows(o.out)
    done = {tuple(r[k] for k in KEYS) for r in rows}
    for seed, task, target, weight in itertools.product(o.seeds, o.tasks, o.targets, o.weights):
        if tuple(map(str, (task, target, weight, o.jitter, int(o.background), seed))) in done:
            continue
        rows.append(run(task, target, weight, seed, o))
        print({k: rows[-1][k] for k in (*KEYS, *MEASURED)}, flush=True)
        write_rows(o.out, rows)


if __name__ == "__main__":
    main()
