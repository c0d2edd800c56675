"""How fast is G trained by one thread, by two in every operation, by two ways at once; alone and beside a busy process?

    python benchmarks/cores.py --config configs/pendulum_quick.yaml

Batches a second of a config's CycleGAN on random images, each case in a process of its own. ``free`` is what ``idapt``
does by itself: two ways where two cores are free, else one thread. Writes results/cores.csv.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  prepares torchvision

import lightning as L
import numpy as np
import torch
from jsonargparse import ArgumentParser
from rendering import write_table

from datamodules import Episode, Trajectories, UnpairedImages, write_trajectories
from idapt_pl.cores import FreeCores
from idapt_pl.run import Run
from idapt_pl.run_config import RunConfig

KEY = ("config", "how", "beside")
HOW = ("one thread", "two threads", "two ways", "free")
BUSY = "while True: pass"
WARM_UP, SECONDS, MANY = 4, 10.0, 100_000


class Clock(L.Callback):
    """Counts batches for so many seconds after the first few."""

    def on_train_batch_end(self, trainer: L.Trainer, module: L.LightningModule, *args: object) -> None:
        index, now = args[2], time.perf_counter()
        if index == WARM_UP:
            self.first, self.began = index, now
        elif index > WARM_UP and now - self.began > SECONDS:
            self.speed, trainer.should_stop = (index - self.first) / (now - self.began), True


class TwoThreads(FreeCores):
    """Two threads in every operation, as torch does by itself."""

    def share(self, module: L.LightningModule, threads: int) -> None:
        torch.set_num_threads(2)


def callback(how: str) -> FreeCores:
    """What shares out the threads."""
    return {"one thread": FreeCores(1), "two threads": TwoThreads(2), "two ways": FreeCores(2), "free": FreeCores()}[
        how
    ]


def random_images(path: Path, size: int, state_dim: int) -> Path:
    """A trajectory file of noise."""
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (41, size, size, 3), np.uint8)
    episode = Episode(np.zeros((40, 1), np.float32), {"pixels": pixels, "state": rng.normal(size=(41, state_dim))})
    write_trajectories(path, Trajectories((episode,) * 5, 0.04, "noise"))
    return path


def measure(config: str, how: str) -> float:
    """Batches a second in this process."""
    parser = ArgumentParser(exit_on_error=False)
    RunConfig.add_arguments(parser)
    known = parser.parse_path(config)
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(RunConfig.from_namespace(parser.instantiate_classes(known)))
        sizes, stack = run.worlds.dimensions, run.worlds.frame_stack
        G = run.context.make.visual(**sizes)
        G.adopt(run.context.make.state_predictor(**sizes).P_S)
        batch = run.context.batches.visual_batch
        resets = max(1, batch // 4) if G.hparams.reset_weight else 0
        files = [random_images(Path(folder) / f"{d}.h5", sizes["image_size"], sizes["state_dim"]) for d in "ST"]
        clock = Clock()
        trainer = L.Trainer(
            accelerator="cpu", max_epochs=1, logger=False, callbacks=[clock, callback(how)], limit_train_batches=MANY,
            enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
        )  # fmt: skip
        trainer.fit(G, datamodule=UnpairedImages(files[:1], files[1:], stack, batch, MANY, 0, resets))
    return clock.speed


def main() -> None:
    """Measure every case."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="configs/pendulum_quick.yaml")
    p.add_argument("--one", help=argparse.SUPPRESS)
    o = p.parse_args()
    if o.one:
        print(json.dumps(measure(o.config, o.one)))
        return
    rows = []
    for beside in ("nothing", "a busy process"):
        for how in HOW:
            busy = [subprocess.Popen([sys.executable, "-c", BUSY])] if beside != "nothing" else []
            command = [sys.executable, "-W", "ignore", __file__, "--config", o.config, "--one", how]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            for process in busy:
                process.kill()
            speed = round(json.loads(done.stdout.splitlines()[-1]), 2)
            rows.append({"config": Path(o.config).stem, "how": how, "beside": beside, "batches_per_s": speed})
    write_table("cores", rows, KEY)


if __name__ == "__main__":
    main()
