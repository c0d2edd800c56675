"""What Algorithm 1 does, and for how long."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from idapt_pl.ranges import COUNT, COUNT_OR_NONE, Range, check_ranges

POLICY_STEPS: dict[str, dict[str, tuple[int, int, int]]] = {
    "paper": {
        "inverted_pendulum": (10_000, 10_000, 10_000),
        "half_cheetah": (200_000, 200_000, 200_000),
        "walker2d": (200_000, 200_000, 200_000),
        "fetch_reach": (10_000, 10_000, 10_000),
        "sawyer_push": (10_000, 10_000, 10_000),
    },
    "official": {
        "inverted_pendulum": (10_000, 100_000, 10_000),
        "half_cheetah": (500_000, 0, 100_000),
        "walker2d": (500_000, 0, 100_000),
        "fetch_reach": (10_000, 500_000, 10_000),
        "sawyer_push": (10_000, 100_000, 10_000),
    },
}
"""Environment steps of π by task: in the plain source, before the first grounding step, and in each.

The paper (appendix, Policy Training) has one length for every policy stage of a task. The authors' code trains longer
at first, or on HalfCheetah and Walker2d asks for a checkpoint, here of its usual length. Neither has a policy of the
plain source; it is the reference for direct transfer.
"""

WALKED_BACKWARDS = ("half_cheetah", "walker2d")
"""Tasks whose task-agnostic data the paper collects by walking backwards (Fig. 4); in the others at random."""

FILLED = ("grounding_steps", "source_policy", "pretrain.policy", "finetune.policy", "exploration")
"""Keys of a schedule that may be null: ``lengths`` says then whose numbers they have."""


def fill_lengths(schedule: Any, task: str, target: str) -> None:
    """Put numbers where a config has null. What was given after a preset is a number already, and stays.

    Args:
        schedule: what a parser made of the key; changed in place, its ``lengths`` are ``given`` then.
        task: whose numbers they are, by name.
        target: likewise; the paper's easy ones have one grounding step.

    Raises:
        ValueError: if there is no number for a null, or no null for ``lengths`` to fill.
    """
    missing, lengths = [key for key in FILLED if schedule[key] is None], schedule["lengths"]
    if lengths == "given":
        if missing:
            raise ValueError(f"schedule.{missing[0]} is null: give a number, or schedule.lengths paper or official")
        return
    if not missing:
        raise ValueError(
            f"schedule.lengths is {lengths}, but there are numbers for all that it says: set to null what it shall say "
            f"({', '.join(FILLED)}), or give schedule.lengths given"
        )
    if task not in POLICY_STEPS[lengths]:
        raise ValueError(f"schedule.lengths: {lengths} has no steps for the task {task!r}; give schedule.{missing[0]}")
    N = 1 if (lengths, target) == ("paper", "easy") else 5
    exploration = "backwards" if task in WALKED_BACKWARDS else "random"
    numbers: dict[str, Any] = dict(zip(FILLED, (N, *POLICY_STEPS[lengths][task], exploration), strict=True))
    for key in missing:
        schedule[key] = numbers[key]
    schedule["lengths"] = "given"


def length_of(steps: int | None) -> int:
    """A number that may be null in a config, once :func:`fill_lengths` has seen it."""
    assert steps is not None, "a schedule was made before its lengths were filled"
    return steps


Exploration = Literal["random", "babble", "rehearse", "expert", "backwards", "random+expert", "random+backwards+expert"]
"""Policies that collect the task-agnostic data."""


@dataclass(frozen=True)
class StageLengths:
    """How long the stages of one grounding step train.

    Args:
        state_predictor: batches for P^S.
        visual: batches for G and P^T.
        dynamics: GARAT rollouts for F; of ``finetune`` alone, as step 0 learns no F.
        policy: environment steps for the policy.
        estimator: batches for the policy's encoder before the policy trains, regressed on the states of D^S as G shows
            it; for ``policy.encoder: supervised``. 0 leaves the encoder to the policy's own training.
        rehearsed: batches for the encoder on rehearsals of the policy; for ``teacher.rehearse``.
        filter: batches for the filter on them; for ``policy.memory``.
    """

    state_predictor: int
    visual: int
    policy: int | None = 10_000
    dynamics: int = 0
    estimator: int = 0
    rehearsed: int = 0
    filter: int = 0


@dataclass(frozen=True)
class Schedule:
    """What Algorithm 1 does, and for how long.

    Args:
        grounding_steps: N.
        images: control steps in each of the task-agnostic datasets.
        source_images: control steps in the source's, where they are to be more: labelled images of the source cost no
            target interaction, and P^S and the policy's encoder overfit few. None for as many as ``images``.
        exploration: the policy that collects them, ``random`` (uniform actions), ``babble`` (slower and at several
            strengths), ``rehearse`` (what the teacher does in the source, replayed open loop), ``expert`` or
            ``backwards`` (policies on true states that are trained in the source, the latter paid for going the other
            way, as if a person were at the controls); or several joined by ``+``, which share the steps evenly.
        exploration_horizon: control steps after which an exploring episode is begun anew, in target and source; None
            for the task's own. What falls early in an episode shows nothing new for the rest of it.
        exploration_strays: share of the control steps in which ``rehearse`` plays random actions, held for some steps
            each, in place of the teacher's.
        interactions: control steps taken in the target in each grounding step.
        source_policy: environment steps in the plain source, for the policy everything starts from; it is
            also the reference for direct transfer.
        paired_steps: so many control steps from the start of each of the target's episodes are played again in the
            source as it is. Images of the same step then show nearly the same to ``visual.reset_weight``, where
            otherwise only first observations do. As many as the two dynamics take to part ways. 0 for none.
        repaired_visual: batches for which G goes on where step 0 found effects, on what the repaired source shows of
            the same exploration. G had learned to take the plain source's poses to the target's, which differ by what
            was missing. 0 leaves G as it is.
        pretrain: stages before the first grounding step.
        finetune: stages of every grounding step.
        action_transformation: learn F; without it only the images are grounded (an ablation).
        accumulate: train P^S and G on all data so far; else on the newest alone.
        rollback: go on with the F of the step before where the new one makes the grounded source clearly less like the
            target, by a fifth of the target's images and actions that it was not fitted to. No reward of the target
            takes part.
        until_settled: end the run with the grounding step whose new recording of the target shows nothing that the
            grounded source does not do already, by images and actions alone; its policy stays. False always takes all
            steps (the paper).
        lengths: whose numbers ``grounding_steps``, ``source_policy`` and both ``policy`` have where they are null, and
            whose ``exploration``: those of the ``paper`` or of the ``official`` code for the task and target.
            ``given``: none is null.
    """

    grounding_steps: int | None = 5
    images: int = 20_000
    source_images: int | None = None
    exploration: Exploration | None = "random"
    exploration_horizon: int | None = None
    exploration_strays: float = 0.0
    interactions: int = 1000
    source_policy: int | None = 10_000
    paired_steps: int = 0
    repaired_visual: int = 0
    pretrain: StageLengths = field(default_factory=lambda: StageLengths(25_000, 100_000, 10_000))
    finetune: StageLengths = field(default_factory=lambda: StageLengths(625, 5000, 10_000, 10))
    action_transformation: bool = True
    accumulate: bool = False
    rollback: bool = False
    until_settled: bool = False
    lengths: Literal["given", "paper", "official"] = "given"

    def __post_init__(self) -> None:
        once = {
            "images": COUNT,
            "source_images": COUNT,
            "interactions": COUNT,
            "paired_steps": COUNT_OR_NONE,
            "repaired_visual": COUNT_OR_NONE,
            "source_policy": COUNT_OR_NONE,
        }
        once |= {
            "grounding_steps": Range(0, 99),
            "exploration_horizon": Range(2, 1e6),
            "exploration_strays": Range(0, 0.9),
        }
        check_ranges("schedule", vars(self), once)
        if self.exploration_strays and self.exploration != "rehearse":
            raise ValueError(
                f"schedule.exploration_strays is {self.exploration_strays}, but they are among the actions of "
                f"exploration: rehearse, and it is {self.exploration}: give rehearse, or no strays"
            )
        for part in ("pretrain", "finetune"):
            lengths = vars(getattr(self, part))
            check_ranges(f"schedule.{part}", lengths, dict.fromkeys(lengths, COUNT_OR_NONE))


def policy_steps(schedule: Schedule) -> int:
    """Environment steps of all of a run's policies together, which references and baselines train for."""
    steps = length_of(schedule.source_policy) + length_of(schedule.pretrain.policy)
    return steps + length_of(schedule.grounding_steps) * length_of(schedule.finetune.policy)


def check_memory(memory: int, rehearse: int, members: int, replays: int, schedule: Schedule) -> None:
    """A policy with a memory is a teacher on estimates, which are learned in rehearsals.

    Args:
        memory: ``policy.memory``.
        rehearse: ``teacher.rehearse``.
        members: ``labels.members``; encoder and filter learn from labels.
        replays: ``labels.replays``; an encoder without a filter does.
        schedule: whose SAC would go on with it, and which says how long encoder and filter learn.

    Raises:
        ValueError: where the one is without the other, SAC is to go on, or nothing would be learned.
    """
    if bool(memory) != bool(rehearse):
        raise ValueError(
            f"policy.memory is {memory}, but teacher.rehearse is {rehearse}: a filter learns in rehearsals, and "
            "they are for a filter. Give both, or neither."
        )
    if members and not memory:
        raise ValueError(
            f"labels.members is {members}, but encoder and filter learn from labels only where teacher.rehearse and "
            "policy.memory are given. Give all three, or set labels.members to 0."
        )
    if replays and memory:
        raise ValueError(
            f"labels.replays is {replays}, but with policy.memory a filter learns from labels over time, and these are "
            "of labels.members: give members, such as 96, and set labels.replays to 0."
        )
    if not memory:
        return
    if schedule.source_policy or schedule.pretrain.policy or schedule.finetune.policy:
        raise ValueError(
            "with policy.memory the policy is the teacher on estimates and SAC does not go on: set "
            "schedule.source_policy, schedule.pretrain.policy and schedule.finetune.policy to 0."
        )
    for name in ("rehearsed", "filter"):
        if getattr(schedule.pretrain, name) < 2:
            raise ValueError(
                f"schedule.pretrain.{name} is {getattr(schedule.pretrain, name)}: half of these batches follow each of "
                "two rehearsals, so that encoder and filter learn. Give at least 2, such as 1500"
            )
