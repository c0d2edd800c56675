"""Can the mass of Sawyer-Push's puck be told from images of pushes? A row for each error of the readings.

    python benchmarks/puck_mass.py
    python benchmarks/puck_mass.py --pushes 200 --errors 0.001 0.01

A scripted hand pushes the puck to its goal, with noise on its commands, in a world whose puck has the hard target's
mass. The same commands are then played with other masses, each from starts in which the puck is off by as much as a
reading of it is wrong; the hand begins where it did. How well each mass says where the puck ends is a Gaussian
likelihood of two numbers a push: means and spreads over the starts, the error of the reading besides. One push in
twenty may end anywhere, since contacts sometimes go another way than all forecasts. ``nats`` is what all pushes
together say for the true mass and against that of the source; 3 would be enough to name it. ``chosen_kg`` is the
likeliest mass, ``spread_mm`` how far ends differ by starts, ``shift_mm`` by mass (medians over pushes). Writes
results/puck_mass.csv.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import numpy as np
from benchmarks.tables import replace_rows
from tqdm import tqdm

from cli.provenance import git_commit
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.envs import VectorStateEnv
from idapt_pl.tasks import make_task

OUT = ROOT / "results" / "puck_mass.csv"
MASSES = (0.01, 0.02, 0.05, 0.1, 0.5)
"""kg; the first is the source's, the third the hard target's."""
SOURCE, TRUE = 0, 2
HAND, GOAL, PUCK = slice(18, 20), slice(25, 27), slice(28, 30)
"""x and y in the state."""
LONGEST, STARTS = 20, 8
"""Control steps of a push, and starts that each is forecast from."""
ANYWHERE, WAY = 0.05, 0.2
"""Share of the pushes that end where no forecast does, and how far a push goes in x and y [m]."""
FIELDS = ("error_mm", "pushes", "seed", "true_kg", "chosen_kg", "nats", "spread_mm", "shift_mm", "commit")


def towards_goal(state: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Command (2,) of a hand that goes behind the puck and then through it, with noise."""
    hand, goal, puck = state[HAND], state[GOAL], state[PUCK]
    way = (goal - puck) / np.linalg.norm(goal - puck)
    beside = np.array([-way[1], way[0]])
    behind = (hand - puck) @ way < -0.05 and abs((hand - puck) @ beside) < 0.03
    wanted = (goal if behind else puck - 0.09 * way) - hand
    return np.clip(wanted / 0.1 + 0.2 * rng.standard_normal(2), -1, 1)


def world(mass: float) -> VectorStateEnv:
    """The source with a puck of that mass."""
    task = make_task("sawyer_push")
    return VectorStateEnv(task, task.domain("source").with_effects(BodyMass("puck", mass)), 1)


def record(env: VectorStateEnv, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A push: commands (t, 2), and where the puck ends (2,) [m]."""
    rng, commands = np.random.default_rng(seed), []
    state = env.reset(seed=seed)[0]["state"][0]
    for _ in range(LONGEST):
        command = towards_goal(state, rng)
        seen, _, ends, cut, _ = env.step(command[None].astype(np.float32))
        if ends[0] or cut[0]:  # it is at its goal, and the next episode has begun
            break
        commands.append(command)
        state = seen["state"][0]
    return np.array(commands), state[PUCK]


def first_seed(seed: int) -> int:
    """Of the resets of a row's pushes; they count up from it."""
    return 1000 * seed


def play(env: VectorStateEnv, commands: np.ndarray, seed: int, moved: np.ndarray) -> np.ndarray:
    """Where the puck ends (2,) [m] if it begins ``moved`` (2,) from where it was."""
    env.reset(seed=seed)
    model, data = env.model, env.data[0]
    adr = model.jnt_qposadr[model.body("puck").jntadr[0]]
    data.qpos[adr : adr + 2] += moved
    end = data.qpos[adr : adr + 2].copy()
    for command in commands:
        _, _, ends, cut, _ = env.step(command[None].astype(np.float32))
        if ends[0] or cut[0]:
            break
        end = data.qpos[adr : adr + 2].copy()
    return end


def forecasts(pushes: Sequence[tuple[np.ndarray, np.ndarray]], error: float, seed: int) -> np.ndarray:
    """Where the puck is expected to end, (masses, pushes, starts, 2) [m]; starts are the same for all masses."""
    moved = error * np.random.default_rng(seed).standard_normal((len(pushes), STARTS, 2))
    ends = np.zeros((len(MASSES), len(pushes), STARTS, 2))
    for m, mass in enumerate(MASSES):
        with closing(world(mass)) as env:
            for k, (commands, _) in enumerate(pushes):
                ends[m, k] = [play(env, commands, first_seed(seed) + k, by) for by in moved[k]]
    return ends


def log_likelihoods(ends: np.ndarray, read: np.ndarray, error: float) -> np.ndarray:
    """Of each mass, (masses,), by readings (pushes, 2) with that error."""
    variance = (1 + 1 / STARTS) * ends.var(2, ddof=1) + error**2  # a mean of so many is not sure either
    near = np.exp(-0.5 * ((read - ends.mean(2)) ** 2 / variance).sum(2)) / (2 * np.pi * np.sqrt(variance.prod(2)))
    return np.log((1 - ANYWHERE) * near + ANYWHERE / WAY**2).sum(1)


def measure(pushes: Sequence[tuple[np.ndarray, np.ndarray]], error: float, seed: int) -> dict:
    """A row: what pushes say of the mass if readings are off by ``error`` [m]."""
    ends = forecasts(pushes, error, seed)
    truth = np.array([end for _, end in pushes])
    read = truth + error * np.random.default_rng(seed + 1).standard_normal(truth.shape)
    told = log_likelihoods(ends, read, error)
    shift = np.linalg.norm(ends[TRUE].mean(1) - ends[SOURCE].mean(1), axis=1)
    return {
        "error_mm": round(1e3 * error, 3), "pushes": len(pushes), "seed": seed, "true_kg": MASSES[TRUE],
        "chosen_kg": MASSES[int(told.argmax())], "nats": round(float(told[TRUE] - told[SOURCE]), 2),
        "spread_mm": round(1e3 * float(np.median(ends[TRUE].std(1, ddof=1))), 2),
        "shift_mm": round(1e3 * float(np.median(shift)), 2), "commit": git_commit(),
    }  # fmt: skip


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--pushes", type=int, default=60, help="as many as 4,000 control steps of exploration show")
    p.add_argument("--errors", type=float, nargs="+", default=[0.0001, 0.001, 0.003, 0.01], help="of readings, m")
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    o = p.parse_args()
    for seed in o.seeds:
        with closing(world(MASSES[TRUE])) as env:
            pushes = [record(env, first_seed(seed) + k) for k in range(o.pushes)]
        for error in tqdm(o.errors, unit="error"):
            row = measure(pushes, error, seed)
            replace_rows(OUT, [row], ("error_mm", "pushes", "seed"), FIELDS)
            print(row)


if __name__ == "__main__":
    main()
