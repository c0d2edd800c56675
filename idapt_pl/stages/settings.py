"""Batch and rollout sizes, and constructors of the modules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from idapt_pl.modules import ActionTransformation, AsymmetricSAC, StatePredictor, VisualTransformation
from idapt_pl.ranges import COUNT, COUNT_OR_NONE, NOT_NEGATIVE, SHARE, Range, check_ranges


@dataclass(frozen=True)
class ModuleFactories:
    """Constructors of the modules with everything set but what the task and data determine."""

    state_predictor: Callable[..., StatePredictor]
    visual: Callable[..., VisualTransformation]
    dynamics: Callable[..., ActionTransformation]
    policy: Callable[..., AsymmetricSAC]


@dataclass(frozen=True)
class BatchSettings:
    """How data reach the modules.

    Args:
        state_predictor_batch: frame stacks in a batch of the state predictor.
        visual_batch: frame stacks of either domain in a batch of the visual transformation.
        num_envs: simulations that SAC acts in side by side.
        updates_per_step: SAC critic updates for each environment step.
        policy_batch: transitions in a SAC minibatch.
        buffer_size: transitions kept for SAC.
        warmup_steps: environment steps before SAC's first update (random actions for a new policy).
        garat_envs: simulations that GARAT rolls out side by side.
        garat_exploring: share of them that explore, compared with the target's task-agnostic data; 0 leaves
            GARAT to the current policy's data alone (the paper).
        garat_rollout: environment steps in one GARAT rollout, over all simulations.
        garat_start: what F is before GARAT: the ``identity`` (the paper), or what trajectory ``matching`` gives, an
            affine law under which short replays in the source follow the target's recordings.
        trial_episodes: episodes in the grounded source, with its reward, on which a policy must do as well after its
            training there as before, or the one before is kept; 0 always goes on with the newest (the paper).
        trial_repeats: how often a policy trains again, as long as before, while it does a tenth worse in those episodes
            than the source's policy in the source; 0 never (the paper).
        garat_ridge: with ``matching``, weight of the squared coefficients.
    """

    state_predictor_batch: int = 32
    visual_batch: int = 1
    num_envs: int = 1
    updates_per_step: int = 1
    policy_batch: int = 32
    buffer_size: int = 10_000
    warmup_steps: int = 1000
    garat_envs: int = 10
    garat_exploring: float = 0.0
    garat_rollout: int = 5000
    garat_start: Literal["identity", "matching"] = "identity"
    garat_ridge: float = 1e4
    trial_episodes: int = 0
    trial_repeats: int = 0

    def __post_init__(self) -> None:
        sizes = ("state_predictor_batch", "visual_batch", "updates_per_step", "policy_batch", "garat_rollout")
        ranges = dict.fromkeys(sizes, Range(1, 1e6)) | dict.fromkeys(("num_envs", "garat_envs"), Range(1, 1024))
        ranges |= {"buffer_size": COUNT, "warmup_steps": COUNT_OR_NONE, "trial_episodes": COUNT_OR_NONE}
        ranges["trial_repeats"] = Range(0, 100)
        check_ranges("feeding", vars(self), ranges | {"garat_exploring": SHARE, "garat_ridge": NOT_NEGATIVE})
        if self.trial_repeats and not self.trial_episodes:
            raise ValueError(
                f"feeding.trial_repeats is {self.trial_repeats}, but no episodes say whether a policy is to train "
                "again: give feeding.trial_episodes, such as 5, or feeding.trial_repeats 0"
            )
        if self.garat_rollout < self.garat_envs:
            raise ValueError(
                f"feeding.garat_rollout is {self.garat_rollout} steps for the {self.garat_envs} simulations of "
                "feeding.garat_envs: at least one for each"
            )


@dataclass(frozen=True)
class LabelSettings:
    """How real images of the target get states to learn from (:mod:`~idapt_pl.stages.labels`). Off by default.

    Args:
        members: simulations of the source that follow a recording, each a guess of the robot's state; 0 labels nothing.
        lag: control steps for which a state goes on being corrected by what is read later.
        known_start: the target's episodes begin as the source's do. Where a first reading says otherwise it counts.
        offsets: whether readings are freed from what they are off by throughout, if forecasts tell it surely.
        replays: for policies by DAgger or SAC, in place of ``members``: simulations of the source that play the
            target's actions, each from a start of its own; 0 labels nothing. What they agree in is taken to be where
            the target is, too (:mod:`~idapt_pl.stages.replayed_labels`).
    """

    members: int = 0
    lag: int = 8
    known_start: bool = True
    offsets: bool = False
    replays: int = 0

    def __post_init__(self) -> None:
        counts = {"members": COUNT_OR_NONE, "replays": COUNT_OR_NONE}
        check_ranges("labels", vars(self), counts | {"lag": Range(0, 1000)})
        if self.replays == 1:
            raise ValueError("labels.replays is 1: one alone agrees with itself. Give 0 for no labels, or about 8")
        if self.members == 1:
            raise ValueError("labels.members is 1: one guess has no spread. Give 0 for no labels, or about 100")


@dataclass(frozen=True)
class PoseSettings:
    """Which poses beside those of motions state predictors see (:mod:`~idapt_pl.stages.moved_poses`). Off by default.

    Args:
        spread: of each joint's own offsets, in units of its spread over the recorded motions; 0 leaves motions as they
            are, such as 0.5 or 1 parts what goes together in them.
        images: of the source in such poses, at each grounding step.
    """

    spread: float = 0.0
    images: int = 3000

    def __post_init__(self) -> None:
        check_ranges("poses", vars(self), {"spread": Range(0, 10), "images": COUNT})


@dataclass(frozen=True)
class FilterSettings:
    """How the filter between encoder and head learns (:class:`.FilterTraining`); ``policy.memory`` is its size.

    Args:
        lr: Adam, annealed to zero.
        stretch: observations in a stretch.
        batch: stretches in a batch.
        gain: spread of the gains that readings have while it learns, new ones for each stretch.
        offset: spread of their offsets, in units of the data's spread.
        noise: spread of what is new in every reading, in those units.
        dropout: share of the readings that do not come.
    """

    lr: float = 1e-3
    stretch: int = 60
    batch: int = 16
    gain: float = 0.15
    offset: float = 0.15
    noise: float = 0.1
    dropout: float = 0.02

    def __post_init__(self) -> None:
        ranges = dict.fromkeys(("lr", "gain", "offset", "noise"), NOT_NEGATIVE)
        ranges |= {"stretch": Range(2, 1e6), "batch": Range(1, 1e6), "dropout": Range(0, 1, "[)")}
        check_ranges("filter", vars(self), ranges)
