"""How many SAC updates a second, ours beside Stable-Baselines3's? On a CPU, sampling from replay included.

    pip install stable-baselines3
    python benchmarks/sac_speed.py [--rounds 5]

Minibatches of 128, nets of 2 x 256, the actor and the temperature with every critic update, 17 state and 6 action
components. ``teacher`` is SAC on states (:class:`~idapt_pl.modules.StateSAC`), ``image policy's heads`` asymmetric SAC
with a supervised encoder, whose replay holds estimates. Ours runs in a Trainer, four updates a batch, as with four
simulations. Every figure is the median of rounds in processes of their own, taken in turns. Writes
results/sac_speed.csv.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

REFERENCE = "Stable-Baselines3"
IMPLEMENTATIONS = (REFERENCE, "teacher", "image policy's heads")
STATE, ACTION, BATCH, HIDDEN = 17, 6, 128, [256, 256]
WARM_UP, UPDATES, PER_BATCH = 100, 1500, 4
KEY = ("implementation", "threads", "cpu")


def stable_baselines() -> float:
    """Updates a second of Stable-Baselines3's SAC."""
    import gymnasium
    from stable_baselines3 import SAC

    class Still(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (STATE,))
        action_space = gymnasium.spaces.Box(-1, 1, (ACTION,))

        def reset(self, **kwargs: object) -> tuple[np.ndarray, dict]:
            return np.zeros(STATE, np.float32), {}

    sac = SAC("MlpPolicy", Still(), batch_size=BATCH, buffer_size=10_000, policy_kwargs={"net_arch": HIDDEN})
    sac.learn(0)
    rng = np.random.default_rng(0)
    for _ in range(10_000):
        now, after = rng.normal(size=(2, 1, STATE)).astype(np.float32)
        action, reward = rng.uniform(-1, 1, (1, ACTION)), rng.normal(size=1)
        sac.replay_buffer.add(now, after, action, reward, np.zeros(1, bool), [{}])
    sac.train(WARM_UP, BATCH)
    started = time.perf_counter()
    sac.train(UPDATES, BATCH)
    return UPDATES / (time.perf_counter() - started)


class Acting:
    """Stands in for simulations: transitions at no cost."""

    recent_return = 0.0

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        states = rng.normal(size=(4, 4, STATE)).astype(np.float32)
        self.transitions = dict(zip(("observation", "state", "next_observation", "next_state"), states, strict=True))
        self.transitions |= {
            "actions": rng.uniform(-1, 1, (4, ACTION)).astype(np.float32),
            "rewards": rng.normal(size=4).astype(np.float32),
            "terminations": np.zeros(4, bool),
        }

    def __call__(self) -> dict[str, np.ndarray]:
        return self.transitions


def ours(kind: str) -> float:
    """Updates a second of a stage's training."""
    import idapt_pl  # noqa: F401, I001  prepares torchvision
    import lightning as L

    from datamodules import ReplayBuffer, ReplayDataModule
    from idapt_pl.modules import AsymmetricSAC, StateSAC
    from idapt_pl.modules.sac import SAC

    class Clock(L.Callback):
        def on_train_batch_end(self, trainer: L.Trainer, module: L.LightningModule, *args: object) -> None:
            if args[2] == WARM_UP // PER_BATCH:
                self.started = time.perf_counter()

        def on_train_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
            self.seconds = time.perf_counter() - self.started

    bounds = [-1.0] * ACTION, [1.0] * ACTION
    module: SAC = StateSAC(STATE, *bounds, hidden=HIDDEN)
    if kind != "teacher":
        module = AsymmetricSAC(
            STATE, *bounds, image_size=64, hidden=HIDDEN, actor_every=1, encoder="supervised", estimator_updates=0
        )
    batches, clock = (WARM_UP + UPDATES) // PER_BATCH + 1, Clock()
    data = ReplayDataModule(Acting(), ReplayBuffer(10_000, 0), BATCH, PER_BATCH, batches)
    trainer = L.Trainer(
        accelerator="cpu", max_epochs=1, callbacks=[clock], logger=False, enable_checkpointing=False,
        enable_progress_bar=False, enable_model_summary=False, log_every_n_steps=batches,
    )  # fmt: skip
    trainer.fit(module, datamodule=data)
    return UPDATES / clock.seconds


def measure(implementation: str, threads: int) -> float:
    """Updates a second in this process."""
    import torch

    torch.set_num_threads(threads)
    return stable_baselines() if implementation == REFERENCE else ours(implementation)


def main() -> None:
    """Measure in turns and keep the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=5)
    p.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    o = p.parse_args()
    if o.one:
        print(json.dumps(measure(o.one[0], int(o.one[1]))))
        return
    from rendering import write_table  # not before: it imports idapt_pl

    cases = list(itertools.product(IMPLEMENTATIONS, (1, 2)))
    speeds: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
    for _, (implementation, threads) in itertools.product(range(o.rounds), cases):
        command = [sys.executable, "-W", "ignore", __file__, "--one", implementation, str(threads)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        speeds[implementation, threads].append(json.loads(done.stdout.splitlines()[-1]))
    medians = {case: statistics.median(each) for case, each in speeds.items()}
    rows = [
        {"implementation": implementation, "threads": threads, "updates_per_s": round(median),
         "times_reference": round(median / medians[REFERENCE, threads], 2)}
        for (implementation, threads), median in medians.items()
    ]  # fmt: skip
    print(*rows, sep="\n", flush=True)
    write_table("sac_speed", rows, KEY)


if __name__ == "__main__":
    main()
