"""Are hidden visual effects found from the first frames of episodes, and nothing where nothing is hidden?

    python benchmarks/looks.py --tasks inverted_pendulum walker2d --seeds 0 1 2

Targets are the source with a camera that was bumped, a lamp that gives other light, a geom of another colour, a lens
out of focus, or several of these; and the benchmark's own easy and hard targets, whose textures are none of the
effects. Errors are those of mean pictures on episodes held out, in 8-bit levels. Writes results/looks.csv.
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
from tables import read_rows, write_rows

from cli.provenance import git_commit
from idapt_pl.appearance import VisualEffects, find_visual_effects
from idapt_pl.appearance.parameters import CameraParameter, visual_parameters
from idapt_pl.effects import Domain, Effect
from idapt_pl.effects.visual import Blur, Color, Light
from idapt_pl.envs import VectorImageEnv
from idapt_pl.tasks import TASKS, Task, make_task

GEOM = {
    "inverted_pendulum": "cart", "half_cheetah": "torso", "walker2d": "torso_geom", "fetch_reach": "table",
    "sawyer_push": "table",
}  # fmt: skip
"""What is painted anew."""
BUMP = np.array([0.02, -0.015, 0.03, 0.02, -0.015, 0.03])
"""Of the camera: shares of its distance to the robot, and rad."""
FIELDS = ("task", "case", "seed", "found", "right", "others", "bump_error", "bump", "before", "after", "floor",
          "episodes", "seconds", "commit")  # fmt: skip


def hidden(task: Task, case: str) -> tuple[Effect, ...]:
    """What is different in a case."""
    source = task.domain("source")
    if case in ("easy", "hard"):
        return task.domain(case).effects[len(source.effects) :]
    effects: list[Effect] = []
    if "camera" in case:
        spec = source.spec()
        effects += camera_of(task).effects(spec, bump(task))
    if "light" in case:
        effects.append(Light("headlight", diffuse=(0.55, 0.45, 0.3), ambient=(0.15, 0.1, 0.05)))
    if "colour" in case:
        effects.append(Color(GEOM[task.name], (0.2, 0.3, 0.8, 1.0)))
    if "blur" in case:
        effects.append(Blur("world", 0.02))
    return tuple(effects)


def camera_of(task: Task) -> CameraParameter:
    """The visual parameter of the source's camera."""
    return next(p for p in visual_parameters(task.domain("source").spec()) if isinstance(p, CameraParameter))


def bump(task: Task) -> np.ndarray:
    """How far the camera is moved: m along its axes, and rad about them."""
    return BUMP * np.repeat([camera_of(task).step[0] / 0.01, 1.0], 3)


def run(name: str, case: str, seed: int, episodes: int) -> dict:
    """One case."""
    task = make_task(name)
    source, effects = task.domain("source"), hidden(task, case)
    target = Domain("hidden", source.base, (*source.effects, *effects))
    with closing(VectorImageEnv(task, target, 1, 64, 1)) as env:
        frames = np.concatenate([env.reset(seed=1000 * (seed + 1) + i)[0]["pixels"][:, 0] for i in range(episodes)])
    started = time.perf_counter()
    result = find_visual_effects(task, source, frames, seed)
    row = {"task": name, "case": case, "seed": seed, "episodes": episodes, **score(task, result, effects, case)}
    return row | {"seconds": round(time.perf_counter() - started, 1), "commit": git_commit()}


def score(task: Task, result: VisualEffects, effects: tuple[Effect, ...], case: str) -> dict:
    """Which of the hidden effects were found, how many others, and how well the camera's place is known."""
    found = [{(e.effect, target) for target in e.target.split()} for e in result.estimates]
    # Two words for where a camera stands.
    truth = {("camera_frame" if e.name == "camera_pose" else e.name, e.target) for e in effects}
    others = [one for one in found if not one <= truth]
    row = {"found": " + ".join(f"{e.effect}({e.target})" for e in result.estimates), "others": len(others)}
    row |= {k: round(getattr(result, k), 2) for k in ("before", "after", "floor")}
    if case not in ("easy", "hard"):
        row["right"] = int(set().union(*found) == truth)
    if "camera" in case:
        cameras = (e for e in result.estimates if e.key == camera_of(task).key)
        moved = next((np.array(list(e.estimate.values())) for e in cameras), np.zeros(6))
        row["bump"], row["bump_error"] = (round(shift(task, v), 4) for v in (bump(task), moved - bump(task)))
    return row


def shift(task: Task, move: np.ndarray) -> float:
    """How far a move of the camera moves what it looks at in the picture, roughly: rad."""
    reach = camera_of(task).step[0] / 0.01
    return float(np.hypot(move[0] / reach - move[4], move[1] / reach + move[3]))


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cases = ("nothing", "camera", "light", "colour", "blur", "camera light colour", "easy", "hard")
    p.add_argument("--tasks", choices=TASKS, nargs="+", default=["inverted_pendulum", "half_cheetah", "walker2d"])
    p.add_argument("--cases", choices=cases, nargs="+", default=cases)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--episodes", type=int, default=20)
    p.add_argument("--out", type=Path, default=ROOT / "results/looks.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    for name in o.tasks:
        for case in o.cases:
            for seed in o.seeds:
                if any((r["task"], r["case"], int(r["seed"])) == (name, case, seed) for r in rows):
                    continue
                rows.append(run(name, case, seed, o.episodes))
                print(*rows[-1].values(), flush=True)
                write_rows(o.out, rows, FIELDS)


if __name__ == "__main__":
    main()
