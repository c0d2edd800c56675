"""Target interactions that the files of a run folder hold: what the ledger must say."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from datamodules.trajectories import count_steps
from idapt_pl.files import blaming, read_json, verify
from idapt_pl.run_folder.kept_episodes import PARTS
from idapt_pl.run_folder.kept_outcomes import SO_FAR, read_outcomes, total_steps
from idapt_pl.run_folder.results import read_result, step_of

VIDEO = "policy_in_grounded_and_target"
VIDEO_STEPS = 75
"""Control steps of the video that an evaluation leaves."""

DIRECT_TRANSFER = "evaluation of direct transfer"
ORACLE, ORACLE_EVALUATION = "oracle reference", "evaluation of the oracle"

EVALUATED_BY_HAND = "evaluation_by_hand.json"
"""Outcomes that a person told `idapt evaluate`."""

KNOWN = re.compile(
    rf"training|evaluation|{DIRECT_TRANSFER}|{ORACLE}|{ORACLE_EVALUATION}|evaluation of .+, \d+ episodes"
    r"(, seed -?\d+| by hand)"
)
"""Purposes whose interactions are in files that are known here; entries of others are left as they are."""


def evaluation_interactions(folder: Path, result: dict) -> int:
    """Of the evaluation of a grounding step: its episodes, and its video, which older results do not count.

    Args:
        folder: of the step.
        result: its ``evaluation.json``.
    """
    older = VIDEO_STEPS if (folder / f"{VIDEO}.gif").exists() else 0
    return result["target"].get("interactions", 0) + result.get("video_interactions", older)


def oracle_interactions(recording: Path, num_envs: int, warmup_steps: int) -> int:
    """Of the oracle reference: its labelled images, and its training once that is done.

    Args:
        recording: ``oracle.h5``, its labelled images.
        num_envs: simulations side by side.
        warmup_steps: before training, as the config has them.
    """
    images, trained = recorded_steps(recording), recording.with_name("oracle") / "stage.json"
    if not trained.with_name("final.ckpt").exists():
        return images
    batches = read_json(trained, ("batches",))["batches"]
    return images + num_envs * (batches + math.ceil(warmup_steps / num_envs))


def later_evaluation(policy: str, episodes: int, seed: int) -> str:
    """The purpose of what ``idapt evaluate`` does."""
    return f"evaluation of {policy}, {episodes} episodes, seed {seed}"


def told_evaluation(policy: str, episodes: int) -> str:
    """The purpose of what a person played and judged."""
    return f"evaluation of {policy}, {episodes} episodes by hand"


def entry(step: int, purpose: str, count: int) -> dict[str, Any]:
    """An entry of the ledger."""
    return {"step": step, "purpose": purpose, "count": int(count)}


def held_interactions(run: Path, num_envs: int, warmup_steps: int) -> tuple[list[dict], list[str]]:
    """Ledger entries that the files of a run folder are proof of.

    Args:
        run: the folder.
        num_envs: as of :func:`oracle_interactions`.
        warmup_steps: as of :func:`oracle_interactions`.

    Returns:
        The entries, and what is wrong with files that cannot be read.
    """
    entries: list[dict] = []
    unreadable: list[str] = []

    def collect(path: Path, read: Callable[[Path], list[dict]]) -> None:
        try:
            with blaming(path):
                entries.extend(read(path))
        except ValueError as error:
            unreadable.append(str(error))

    for folder in sorted(run.glob("step_*")):
        if (step := step_of(folder)) is None:
            continue
        for name, (purpose, count) in counted_files(step, num_envs, warmup_steps).items():
            if (folder / name).exists():
                collect(folder / name, partial(counted_entries, step, purpose, count))
        if (folder / PARTS).exists() and not (folder / "target.h5").exists():
            collect(folder / PARTS, partial(counted_entries, step, "training", parts_steps))
        for name, purpose in {"direct_transfer": DIRECT_TRANSFER, "evaluation": "evaluation"}.items():
            if (path := folder / f"{name}{SO_FAR}").exists() and not (folder / f"{name}.json").exists():
                collect(path, partial(counted_entries, step, purpose, so_far_steps))
    for path in sorted(run.glob("evaluation_*.json")):
        if not path.name.endswith(SO_FAR):
            collect(path, later_entries)
        elif not path.with_name(path.name.replace(SO_FAR, ".json")).exists():
            collect(path, later_outcome_entries)
    return entries, unreadable


def counted_files(step: int, num_envs: int, warmup_steps: int) -> dict[str, tuple[str, Callable[[Path], int]]]:
    """Files of a grounding step that hold target interactions, by name: their purpose, and what counts them."""
    files: dict[str, tuple[str, Callable[[Path], int]]] = {
        "target.h5": ("training", recorded_steps),
        "evaluation.json": ("evaluation", evaluated_steps),
    }
    if step == 0:
        files |= {
            "direct_transfer.json": (DIRECT_TRANSFER, measured_steps),
            "oracle.h5": (ORACLE, partial(oracle_interactions, num_envs=num_envs, warmup_steps=warmup_steps)),
            "oracle_evaluation.json": (ORACLE_EVALUATION, measured_steps),
        }
    return files


def counted_entries(step: int, purpose: str, count: Callable[[Path], int], path: Path) -> list[dict]:
    """The entry of a file that holds one."""
    return [entry(step, purpose, count(path))]


def recorded_steps(path: Path) -> int:
    """Control steps of a recording that is as it was written."""
    verify(path)
    return count_steps(path)


def parts_steps(folder: Path) -> int:
    """Control steps of a recording that is not complete."""
    return sum(map(recorded_steps, sorted(folder.glob("*.h5"))))


def so_far_steps(path: Path) -> int:
    """Control steps of a measurement that is not complete."""
    return total_steps(read_outcomes(path))


def measured_steps(path: Path) -> int:
    """Control steps that a measurement took."""
    return read_result(path)["interactions"]


def evaluated_steps(path: Path) -> int:
    """Control steps of the evaluation of a grounding step."""
    return evaluation_interactions(path.parent, read_result(path))


def later_entries(path: Path) -> list[dict]:
    """Entries of a file that ``idapt evaluate`` wrote."""
    result = read_json(path, cure="Delete it, or run the same `idapt evaluate` again.")

    def purpose(name: str, target: dict) -> str:
        if path.name == EVALUATED_BY_HAND:
            return told_evaluation(name, len(target["returns"]))
        return later_evaluation(name, result["episodes"], result["seed"])

    there = {name: domains["target"] for name, domains in result["policies"].items()}
    return [entry(-1, purpose(name, target), target["interactions"]) for name, target in there.items()]


def later_outcomes(episodes: int, seed: int) -> str:
    """The name of a measurement by ``idapt evaluate``, for outcomes that are kept until it is complete."""
    return f"evaluation_{episodes}_{seed}"


def later_outcome_entries(path: Path) -> list[dict]:
    """Entries of what an ``idapt evaluate`` that is not complete has kept."""
    _, episodes, seed = path.name.removesuffix(SO_FAR).split("_")
    steps: Counter[str] = Counter()
    for known in read_outcomes(path):
        steps[known["policy"]] += known["steps"]
    return [entry(-1, later_evaluation(name, int(episodes), int(seed)), n) for name, n in steps.items()]


def reconciled(entries: list[dict], held: list[dict]) -> list[dict]:
    """What the ledger should have: what files are proof of, and entries of purposes that are not known here."""
    return held + [e for e in entries if not KNOWN.fullmatch(e["purpose"])]


def disagreements(entries: list[dict], held: list[dict]) -> list[str]:
    """How a ledger differs from what the files of its run hold, a sentence each."""

    def counts(listed: list[dict]) -> dict[tuple[int, str], int]:
        return {(e["step"], e["purpose"]): e["count"] for e in listed}

    noted, real = counts(entries), counts(reconciled(entries, held))
    told = []
    for key in sorted({*noted, *real}):
        if noted.get(key) != real.get(key):
            says = f"the ledger says {noted[key]}" if key in noted else "the ledger has no entry"
            holds = f"the files hold {real[key]}" if key in real else "no file holds them"
            told.append(f"step {key[0]}, {key[1]}: {says}, {holds}")
    return told
