"""``idapt evaluate``: returns of a finished run's policies in the target and the source, measured anew."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

from cli.arguments import parser
from cli.run_folder import load_policy, open_run
from idapt_pl.files import write_json
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.rl.policy import deterministic
from idapt_pl.rl.returns import Returns, evaluate


def main(args: list[str]) -> int:
    """Run ``idapt evaluate``."""
    p = parser("evaluate", __doc__)
    p.add_argument("--run", type=Path, required=True, help="run folder")
    p.add_argument("--episodes", type=int, default=100, help="episodes for each return")
    p.add_argument("--seed", type=int, default=12345, help="of the episodes' starts")
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    o = p.parse_args(args)
    grounding = open_run(o.run)
    result = {
        "run": str(o.run),
        "episodes": o.episodes,
        "seed": o.seed,
        "policies": measure(grounding, o.episodes, o.seed),
    }
    write_json(o.run / f"evaluation_{o.episodes}_{o.seed}.json", result)
    if o.json:
        print(json.dumps(result, indent=2))
        return 0
    print(f"{'policy':<28}{'target':>18}{'plain source':>18}")
    for name, r in result["policies"].items():
        cells = [f"{r[d]['mean']:.2f} ± {r[d]['std']:.2f}" if d in r else "-" for d in ("target", "source")]
        print(f"{name:<28}{cells[0]:>18}{cells[1]:>18}")
    return 0


def measure(grounding: IterativeGrounding, episodes: int, seed: int) -> dict[str, dict]:
    """Returns of every policy the run has kept."""
    worlds = grounding.worlds
    results: dict[str, dict] = {}
    for name, path in policies(grounding):
        policy = load_policy(grounding, path)
        envs = {"target": worlds.rewarded_target(min(episodes, 25))}
        if name == "direct transfer":  # the others expect translated images
            envs["source"] = worlds.source(min(episodes, 25))
        results[name] = {}
        for domain, env in envs.items():
            with closing(env):
                results[name][domain] = as_dict(evaluate(env, deterministic(policy), episodes, seed))
        worlds.ledger.enter(
            -1, f"evaluation of {name}, {episodes} episodes, seed {seed}", results[name]["target"]["interactions"]
        )
    return results


def as_dict(r: Returns) -> dict:
    """JSON form of returns."""
    values = {"returns": list(r.returns), "successes": list(r.successes)}
    return {"mean": r.mean, "std": r.std, **values, "interactions": r.interactions}


def policies(grounding: IterativeGrounding) -> list[tuple[str, Path]]:
    """Names and checkpoints of the run's finished policies, in the order they were trained."""
    run = grounding.stages.run_dir
    found = [
        ("direct transfer", run / "step_00/source_policy/final.ckpt"),
        ("visual grounding, step 0", run / "step_00/policy/final.ckpt"),
    ]
    found += [
        (f"IDAPT, grounding step {k}", grounding.stages.folder(k) / "policy/final.ckpt")
        for k in range(1, grounding.schedule.grounding_steps + 1)
    ]
    found += [("oracle", run / "step_00/oracle/final.ckpt")]
    existing = [(name, path) for name, path in found if path.exists()]
    if not existing:
        raise ValueError(f"{run} has no finished policy yet; resume it with: idapt fit --config {run / 'config.yaml'}")
    return existing
