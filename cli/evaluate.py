"""``idapt evaluate``: returns of a finished run's policies in the target and the source, measured anew."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from cli.arguments import parser
from datamodules.unpaired import read_all
from idapt_pl.envs import TargetFailed
from idapt_pl.evaluation.estimates import EstimateErrors
from idapt_pl.evaluation.told_outcomes import read_told_outcomes
from idapt_pl.files import write_json
from idapt_pl.ranges import COUNT_OR_NONE, SEED, Range, check_ranges
from idapt_pl.rl.physics_observer import ActingByPhysics
from idapt_pl.rl.policy import Policy, deterministic
from idapt_pl.rl.returns import EpisodeOutcome, evaluate
from idapt_pl.run import Run
from idapt_pl.run_folder.interactions import EVALUATED_BY_HAND, later_entries, later_outcome_entries, later_outcomes
from idapt_pl.run_folder.kept_outcomes import KeptOutcomes
from idapt_pl.run_folder.results import newest_of, step_of
from idapt_pl.stages.labels import reading_error_factor, smoother_of
from idapt_pl.stages.schedule import length_of


def main(args: list[str]) -> int:
    """Run ``idapt evaluate``."""
    p = parser("evaluate", __doc__)
    p.add_argument("--run", type=Path, required=True, help="run folder")
    p.add_argument("--episodes", type=int, default=100, help="episodes for each return")
    p.add_argument("--seed", type=int, default=12345, help="of the episodes' starts")
    p.add_argument(
        "--physics",
        type=int,
        default=0,
        metavar="MEMBERS",
        help="let policies act on states that so many simulations of the repaired source agree on with what is read of "
        "the images, in place of their filter; about 100",
    )
    p.add_argument(
        "--outcomes",
        type=Path,
        metavar="CSV",
        help="of a target that is known from recordings alone: what you saw when you played exported policies there; "
        "columns step, outcome, control_steps, a row for each episode (docs/guide/own_robot.md)",
    )
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    o = p.parse_args(args)
    values = {"--episodes": o.episodes, "--seed": o.seed, "--physics": o.physics}
    check_ranges("", values, {"--episodes": Range(1, 1e6), "--seed": SEED, "--physics": COUNT_OR_NONE})
    run = Run.open(o.run)
    if run.config.method.startswith("cc_"):
        raise ValueError(
            f"{o.run} is a run of {run.config.method}, whose policy acts on translations of the target: what it "
            "reached is in its summary.json. For other episodes, run it again with --episodes and a new --run_dir"
        )
    if o.outcomes is not None or not run.worlds.target.playable:
        table = run.folder / EVALUATED_BY_HAND
        run.restore_ledger()
        earlier, told = table.exists(), told_policies(run, o.outcomes)
        if earlier:
            run.restore_ledger()  # once more: an earlier table counts no more
        return reported(run, told, table, o.json)
    if not run.worlds.target.measured:
        raise ValueError(
            f"the target {run.worlds.target.name} is not measured. To have its rewards read (or, with ask, to be "
            f"asked): idapt fit --config {o.run / 'config.yaml'} --target.measure true; then the same command again"
        )
    if o.physics:
        check_physics(run, o.physics)
    run.restore_ledger()
    result = {
        "run": str(o.run),
        "episodes": o.episodes,
        "seed": o.seed,
        "policies": by_physics(run, o.episodes, o.seed, o.physics)
        if o.physics
        else measure_policies(run, o.episodes, o.seed),
    }
    how = f"_physics{o.physics}" if o.physics else ""
    path = o.run / f"evaluation_{o.episodes}_{o.seed}{how}.json"
    write_json(path, result, checked=True)
    if not o.physics:
        KeptOutcomes(run.folder, later_outcomes(o.episodes, o.seed)).forget()
    return reported(run, result, path, o.json)


def reported(run: Run, result: dict, path: Path, as_json: bool) -> int:
    """Count and print what was measured. Returns the exit code."""
    for entry in later_entries(path):
        run.worlds.ledger.enter(entry["step"], entry["purpose"], entry["count"])
    if as_json:
        print(json.dumps(result, indent=2))
        return 0
    print(f"{'policy':<28}{'target':>18}{'plain source':>18}")
    for name, r in result["policies"].items():
        cells = [f"{r[d]['mean']:.2f} ± {r[d]['std']:.2f}" if d in r else "-" for d in ("target", "source")]
        print(f"{name:<28}{cells[0]:>18}{cells[1]:>18}")
    return 0


def told_policies(run: Run, table: Path | None) -> dict:
    """What a person saw of policies in a target that cannot be played from here; kept in the run folder.

    Raises:
        ValueError: if there is no table, it makes no sense, or the target can be played.
    """
    target = run.worlds.target
    if target.playable:
        raise ValueError(f"--outcomes is for recorded targets; {target.name} can be played: target: {{measure: ask}}")
    if table is None:
        raise ValueError(
            f"the target {target.name} is known from recordings alone, and cannot be played from here. Play an "
            "exported policy (idapt export), write down how each episode went, and give --outcomes outcomes.csv"
        )
    told = read_told_outcomes(table, run.worlds.task.metric == "success")
    names = {played_as(path): name for name, path in finished_policies(run)}
    if unknown := set(told) - set(names):
        raise ValueError(f"{table}: step is {sorted(unknown)[0]!r}; the run has policies of {', '.join(names)}")
    policies = {name: {"target": told[step].to_dict()} for step, name in names.items() if step in told}
    result = {"run": str(run.folder), "policies": policies}
    write_json(run.folder / EVALUATED_BY_HAND, result, checked=True)
    return result


def played_as(checkpoint: Path) -> str:
    """What a table of outcomes calls a policy: its grounding step, ``direct`` for the source's, or ``oracle``."""
    stage, step = checkpoint.parent.name, checkpoint.parent.parent.name
    return {"source_policy": "direct", "policy": str(step_of(Path(step)))}.get(stage, stage)


def measure_policies(run: Run, episodes: int, seed: int) -> dict[str, dict]:
    """Returns of every policy the run has kept.

    Raises:
        TargetFailed: if the target fails; the message says what is kept.
    """
    results: dict[str, dict] = {}
    for name, path in finished_policies(run):
        policy = run.load_policy(path)
        results[name] = {"target": in_target(run, name, deterministic(policy), episodes, seed)}
        if name == "direct transfer":  # the others expect translated images
            with closing(run.worlds.image_env(run.plain_source, min(episodes, 25))) as env:
                results[name]["source"] = evaluate(env, deterministic(policy), episodes, seed).to_dict()
    return results


def in_target(run: Run, name: str, act: Policy, episodes: int, seed: int) -> dict:
    """Return of one policy in the target; what a target brings that cannot be played again is kept meanwhile."""
    worlds, kept = run.worlds, KeptOutcomes(run.folder, later_outcomes(episodes, seed))
    before = [EpisodeOutcome(**known["outcome"]) for known in kept if known["policy"] == name]

    def keep(outcome: EpisodeOutcome) -> None:
        if not worlds.target.repeatable:
            kept.add({"policy": name, "steps": outcome.steps, "outcome": asdict(outcome)})

    try:
        with closing(worlds.rewarded_target(min(episodes, 25))) as env:
            return evaluate(env, act, episodes, seed, before=before, keep=keep).to_dict()
    except TargetFailed as failure:
        for known in later_outcome_entries(kept.path) if kept.steps else ():
            worlds.ledger.enter(known["step"], known["purpose"], known["count"])
        whole = sum(known["outcome"]["whole"] for known in kept if known["policy"] == name)
        raise TargetFailed(
            f"{failure}. {whole} of {episodes} episodes of {name} are kept; when the target works again, the same "
            "command goes on"
        ) from failure


def check_physics(run: Run, members: int) -> None:
    """Whether a run's policies can act by physics.

    Raises:
        ValueError: naming what is in the way.
    """
    if members == 1:
        raise ValueError("--physics is 1: one guess has no spread. Give about 100")
    if run.config.modules["policy"]["encoder"] != "supervised":
        raise ValueError("--physics corrects readings of states, and this run's policies read none (policy.encoder)")
    if list(run.folder.glob("step_*/dynamics/final.ckpt")):
        raise ValueError("--physics plays the policy's actions in the source as they are, and this run has an F")
    if not run.worlds.target.has_states:
        raise ValueError(f"--physics reports errors of states, which {run.worlds.target.name} does not show")
    task = run.worlds.task
    try:
        task.motion(np.zeros((1, run.worlds.dimensions["state_dim"])), 1.0)
    except ValueError:
        raise ValueError(f"--physics needs positions, which the states of {task.name} do not tell") from None


def by_physics(run: Run, episodes: int, seed: int, members: int) -> dict[str, dict]:
    """Returns in the target, and errors of the state, of the grounding steps' policies on states by physics."""
    results = {}
    for name, path in finished_policies(run):
        if path.parent.name != "policy":
            continue  # it knows no translated images
        act = acting_by_physics(run, path, members)
        errors = EstimateErrors(act)
        with closing(run.worlds.rewarded_target(min(episodes, 25))) as env:
            found = evaluate(env, act, episodes, seed, errors).to_dict()
        results[f"{name}, by {members} simulations"] = {"target": found | {"state_errors": errors.to_dict()}}
    return results


def acting_by_physics(run: Run, checkpoint: Path, members: int) -> ActingByPhysics:
    """A grounding step's policy on states by physics. Its step's recordings say how wrong readings are."""
    folder, policy = checkpoint.parent.parent, run.load_policy(checkpoint)
    target, known = read_all([folder / "target.h5"]), newest_of(folder, "translated.h5")
    smooth, _, scale = smoother_of(run.context, target, known, policy.actor.encoder, None)
    smooth = replace(smooth, members=members)
    G = run.load_visual(newest_of(folder, "visual/final.ckpt"))
    factor = reading_error_factor(run.context, smooth, policy.actor.encoder, G, scale, seed=0)["factor"]
    return ActingByPhysics(policy, smooth.supposing(factor))


def finished_policies(run: Run) -> list[tuple[str, Path]]:
    """Names and checkpoints of the run's finished policies, in the order they were trained."""
    found = [
        ("direct transfer", run.folder / "step_00/source_policy/final.ckpt"),
        ("visual grounding, step 0", run.folder / "step_00/policy/final.ckpt"),
    ]
    found += [
        (f"IDAPT, grounding step {k}", run.step_folder(k) / "policy/final.ckpt")
        for k in range(1, length_of(run.config.schedule.grounding_steps) + 1)
    ]
    found += [("oracle", run.folder / "step_00/oracle/final.ckpt")]
    existing = [(name, path) for name, path in found if path.exists()]
    if not existing:
        raise ValueError(
            f"{run.folder} has no finished policy yet; resume it with: idapt fit --config {run.folder / 'config.yaml'}"
        )
    return existing
