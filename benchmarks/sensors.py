"""How good would a sensor of poses have to be to name what the locomotion targets lack? From true states, made worse.

    python benchmarks/sensors.py [--tasks half_cheetah walker2d] [--targets easy hard] [--seeds 0]

Records exploration in a world that looks like the source and moves like a target, and diagnoses the source by it with
the candidates that the grounding loop considers. Sensors: ``velocities`` (exact positions and velocities),
``positions`` (exact positions once a control step), positions with white noise of 1 and 5 % of each joint's spread,
and ``states``: what a sensor that reads the task's state can tell, which leaves out where along the track the machine
is, with 5 % of noise on positions and 30 % on speeds. Images are read less well, so what is not named here is not
named from them. A target ``source`` hides nothing.
Writes results/sensors.csv, a row a case.
"""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
from tables import replace_rows

from cli.provenance import git_commit
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.image_diagnosis.settings import DEFAULT_CANDIDATES
from idapt_pl.effects import Domain, visual
from idapt_pl.effects.base import Effect
from idapt_pl.envs import VectorStateEnv
from idapt_pl.rl.exploration import EXPLORATION
from idapt_pl.tasks import Task, make_task

SENSORS = {
    "velocities": 0.0, "positions": 0.0, "positions, 1 % noise": 0.01, "positions, 5 % noise": 0.05, "states": 0.05,
}  # fmt: skip
SPEED_NOISE = 0.3
LENGTH = 50
"""Control steps of an episode."""


def moving_like(task_name: str, target: str) -> tuple[Domain, tuple[Effect, ...]]:
    """A world that looks like the source, and what it has beside the source's effects."""
    task = make_task(task_name)
    source, other = task.domain("source"), task.domain(target)
    hidden = tuple(e for e in other.effects[len(source.effects) :] if type(e).__module__ != visual.__name__)
    return Domain("hidden", source.base, (*source.effects, *hidden)), hidden


def record(task_name: str, domain: Domain, steps: int, seed: int) -> tuple[list[tuple[np.ndarray, ...]], float]:
    """Episodes as (positions, velocities, actions), and the control period [s]."""
    task = make_task(task_name)
    with closing(VectorStateEnv(task, domain)) as env:
        act, data, episodes = EXPLORATION["babble"](env, seed), env.data[0], []
        for k in range(steps // LENGTH):
            env.reset(seed=1000 * seed + k)
            rows = [(data.qpos.copy(), data.qvel.copy())]
            actions = []
            while len(actions) < LENGTH:
                action = act(np.zeros((1, 1)))[0]
                for _ in range(task.action_repeat):  # also after a fall, which would end the task
                    task.play(env.model, data, action)
                actions.append(action)
                rows.append((data.qpos.copy(), data.qvel.copy()))
            episodes.append((*map(np.array, zip(*rows, strict=True)), np.array(actions)))
        return episodes, env.dt


def sensed(task: Task, episodes: list[tuple[np.ndarray, ...]], sensor: str, dt: float, seed: int) -> Trajectories:
    """The recordings as a sensor gives them."""
    rng = np.random.default_rng(seed)
    fast = np.concatenate([v for _, v, _ in episodes]).std(0)
    spread = np.concatenate([q - q.mean(0) for q, *_ in episodes]).std(0) * SENSORS[sensor]
    made = []
    for q, v, actions in episodes:
        if sensor == "states":
            shown = (q + spread * rng.standard_normal(q.shape))[:, 1:]
            states = np.concatenate([shown, v + SPEED_NOISE * fast * rng.standard_normal(v.shape)], 1)
            made.append(Episode(actions, {"qpos": task.motion(states, dt)[0]}))
            continue
        seen = {"qpos": q + spread * rng.standard_normal(q.shape)}
        made.append(Episode(actions, seen | ({"qvel": v} if sensor == "velocities" else {})))
    return Trajectories(tuple(made), dt, sensor)


def run(task_name: str, target: str, sensor: str, seed: int, steps: int) -> dict:
    """One case."""
    task = make_task(task_name)
    domain, hidden = moving_like(task_name, target)
    episodes, dt = record(task_name, domain, steps, seed)
    started = time.perf_counter()
    found = diagnose(
        task.domain("source").spec(), sensed(task, episodes, sensor, dt, seed),
        candidates=DEFAULT_CANDIDATES, seed=seed, settings=SearchSettings(max_effects=2),
        unmeasured=task.unseen if sensor == "states" else (),
    ).report  # fmt: skip
    error = found["error"]
    truth = {(e.name, e.target) for e in hidden}
    named = [e for e in found["effects"] if e["effect"] != "numerics"]
    right = named[0]["effect"] in {name for name, _ in truth} if named and truth else not named and not truth
    return {
        "task": task_name, "target": target, "sensor": sensor, "seed": seed, "verdict": found["verdict"],
        "found": " + ".join(map(in_words, named)), "kind_named_first": int(right),
        "hidden": " + ".join(f"{n}({t})" for n, t in sorted(truth)),
        "before": error["before"], "after": error["after"], "floor": error["noise_floor"], "ceiling": error["ceiling"],
        "horizon_s": error["horizon_s"], "steps": steps, "seconds": round(time.perf_counter() - started, 1),
        "commit": git_commit(),
    }  # fmt: skip


def in_words(e: dict) -> str:
    """An effect with its estimates."""
    values = ", ".join(f"{p['estimate']:.4g}" for p in e["parameters"].values())
    return f"{e['effect']}({e['target']}) = {values}"


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--tasks", nargs="+", default=["half_cheetah", "walker2d"])
    p.add_argument("--targets", nargs="+", default=["easy", "hard"])
    p.add_argument("--sensors", nargs="+", choices=SENSORS, default=list(SENSORS))
    p.add_argument("--seeds", type=int, nargs="+", default=[0])
    p.add_argument("--steps", type=int, default=5000)
    p.add_argument("--out", type=Path, default=ROOT / "results/sensors.csv")
    o = p.parse_args()
    cases = [(t, g, s, seed) for seed in o.seeds for s in o.sensors for t in o.tasks for g in o.targets]
    for task, target, sensor, seed in cases:
        row = run(task, target, sensor, seed, o.steps)
        print(*row.values(), flush=True)
        replace_rows(o.out, [row], ("task", "target", "sensor", "seed"))


if __name__ == "__main__":
    main()
