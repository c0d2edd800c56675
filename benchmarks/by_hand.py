"""A robot that only recordings come from: by hand, while a run waits, and from recordings alone.

    pip install pybullet
    python benchmarks/by_hand.py --seeds 1
    python benchmarks/by_hand.py --seeds 2 --recordings runs/by_hand_1_inbox

Does what a person does who has another Python on the robot's side. ``idapt fit`` says what it needs and ends; what it
asks for is played in the cart-pole of ``examples/bullet_cartpole.py``, by the table of actions or by the policy with
the ``play.py`` that lies beside it; pictures and actions go into the folder that it named, and the same command is
given again. At the end the policy is exported and played for 20 episodes, which ``idapt evaluate --outcomes`` is told.
With ``--recordings`` a run of another seed learns from such a folder instead. Adds rows to results/own_targets.csv.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import quick
import yaml
from PIL import Image
from tables import replace_rows

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples"))
EXAMPLE = ROOT / "examples/cartpole_pybullet.yaml"
WAITS = 3
"""Exit code of a run that needs recordings."""
HORIZON = 1000
"""Control steps of an episode, as the source's."""

Act = Callable[[np.ndarray], np.ndarray]


def idapt(*words: str) -> int:
    """Give a command; its exit code."""
    command = [sys.executable, "-c", "import sys; from cli.main import main; sys.exit(main())", *words]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def config_for(target: dict, out: Path) -> Path:
    """The example's config with another target."""
    config = yaml.safe_load(EXAMPLE.read_text())
    config["target"] = {k: config["target"][k] for k in ("name", "actions")} | target
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(yaml.safe_dump(config))
    return out


def played_policy(folder: Path, file: str = "policy.onnx"):
    """The policy as ``play.py`` beside it plays it."""
    sys.dont_write_bytecode = True
    spec = importlib.util.spec_from_file_location("play", folder / "play.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.PlayedPolicy(str(folder / file))


def recorded(folder: Path) -> list[int]:
    """Control steps of the episodes that lie there."""
    tables = folder.glob("episode_*/actions.csv")
    return [len(np.loadtxt(table, skiprows=1, ndmin=1)) for table in tables]


def record(env, act: Act, begin: Callable[[], None], folder: Path, steps: int) -> None:
    """Episodes of so many control steps together: pictures before the first action and after each, and a table."""
    taken, number = 0, len(recorded(folder))
    while taken < steps:
        number += 1
        episode = folder / f"episode_{number:03d}"
        shutil.rmtree(episode, ignore_errors=True)  # one without a table, that was not played to its end
        episode.mkdir()
        begin()
        image, _ = env.reset(seed=number)
        Image.fromarray(image).save(episode / "00000.png")
        actions, over = [], False
        while not over and len(actions) < HORIZON and taken < steps:
            actions.append(act(image))
            image, _, over, _, _ = env.step(actions[-1])
            taken += 1
            Image.fromarray(image).save(episode / f"{len(actions):05d}.png")
        np.savetxt(episode / "actions.csv", actions, delimiter=",", header="force", comments="")


def bring(inbox: Path, env, interactions: int) -> None:
    """Record what a waiting run has asked for: the newest folder of its inbox."""
    place = max(inbox.glob("step_*"))
    brought = sum(recorded(place))
    if (place / "policy.onnx").exists():
        policy = played_policy(place)
        record(env, policy, policy.begin, place, interactions - brought)
        return
    rows = np.loadtxt(place / "actions_to_play.csv", delimiter=",", skiprows=1, ndmin=2, dtype=np.float32)
    left = iter(rows[brought:])
    record(env, lambda image: next(left), lambda: None, place, len(rows) - brought)


def outcomes(env, policy, episodes: int) -> list[tuple[float, int]]:
    """Return and control steps of whole episodes."""
    found = []
    for i in range(episodes):
        policy.begin()
        image, _ = env.reset(seed=10_000 + i)
        gained, over, t = 0.0, False, 0
        while not over and t < HORIZON:
            image, reward, over, _, _ = env.step(policy(image))
            gained, t = gained + reward, t + 1
        found.append((gained, t))
    return found


def measure(run: Path, inbox: Path, env, episodes: int, name: str) -> list[dict]:
    """Play the policies that the run asked for and the last one, exported; tell the run, and make rows of it."""
    assert idapt("export", "--run", str(run), "--out", str(run / "exported/policy.onnx")) == 0
    asked = sorted(path.parent for path in inbox.glob("step_*/policy.onnx"))
    policies = {policy.about["policy"]: policy for policy in map(played_policy, [*asked, run / "exported"])}
    found = {int(k.removeprefix("step_")): outcomes(env, policy, episodes) for k, policy in policies.items()}
    with (run / "outcomes.csv").open("w", newline="") as file:
        told = [(step, *outcome) for step, played in found.items() for outcome in played]
        csv.writer(file).writerows([("step", "outcome", "control_steps"), *told])
    assert idapt("evaluate", "--run", str(run), "--outcomes", str(run / "outcomes.csv")) == 0
    summary, ran = (json.loads((run / f"{n}.json").read_text()) for n in ("summary", "run"))
    common = {
        "task": summary["task"], "target": summary["target"], "run": name, "seed": summary["seed"],
        "metric": summary["metric"], "target_interactions": summary["target_interactions"],
        "minutes": round(summary["wall_s"] / 60, 1), "threads": ran["cpu_threads"], "commit": ran["git_commit"],
        "cpu": ran["cpu"],
    }  # fmt: skip
    rows = []
    for step, played in found.items():
        returns = [gained for gained, _ in played]
        spread = {"mean": round(float(np.mean(returns)), 2), "std": round(float(np.std(returns)), 2)}
        rows.append(common | spread | {"method": "IDAPT" if step else "visual only", "grounding_step": step})
    return rows


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[1])
    p.add_argument("--recordings", type=Path, metavar="INBOX", help="of a run by hand: learn from these alone")
    p.add_argument("--episodes", type=int, default=20)
    p.add_argument("--runs", type=Path, default=ROOT / "runs")
    p.add_argument("--out", type=Path, default=ROOT / "results/own_targets.csv")
    o, extra = p.parse_known_args()
    from bullet_cartpole import BulletCartPole

    env = BulletCartPole()
    for seed in o.seeds:
        name = "recordings" if o.recordings else "by hand"
        run = (o.runs / f"{name.replace(' ', '_')}_{seed}").resolve()
        inbox = run.with_name(f"{run.name}_inbox")
        files = sorted(map(str, o.recordings.resolve().glob("step_*"))) if o.recordings else []
        config = config_for({"recordings": files} if files else {"by_hand": str(inbox)}, run.with_suffix(".yaml"))
        told = ("fit", "--config", str(config), "--seed", str(seed), "--run_dir", str(run), *extra)
        while (code := idapt(*told)) == WAITS and not files:
            bring(inbox, env, yaml.safe_load((run / "config.yaml").read_text())["schedule"]["interactions"])
        if code:
            raise SystemExit(code)
        rows = measure(run, inbox, env, o.episodes, name)
        replace_rows(o.out, rows, ("task", "target", "run", "seed"), quick.FIELDS)
        print(rows)


if __name__ == "__main__":
    main()
