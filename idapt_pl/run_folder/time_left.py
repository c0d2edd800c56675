"""How long the rest of a run takes: the expected costs of its stages, in proportion to what they have cost so far."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

EARLY = 0.1
"""Share of a run after which what it has cost counts as much as what was expected of it."""


class TimeLeft:
    """Counts down the stages of a run.

    Args:
        expected: (grounding step, stage) to seconds on the machine on which costs were measured; their proportions are
            what counts.
    """

    def __init__(self, expected: Mapping[tuple[int, str], float]) -> None:
        self._left, self._costs = dict(expected), dict(expected)
        self._taken = self._expected = EARLY * sum(expected.values())

    def done(self, step: int, name: str, seconds: float | None) -> float:
        """Seconds left after a stage that took so many; None if it was done before."""
        cost = self._left.pop((step, name), 0.0)
        if seconds is not None and cost:
            self._taken += seconds
            self._expected += cost
        return sum(self._left.values()) * self._taken / max(self._expected, 1e-9)

    def again(self, step: int, names: Collection[str]) -> None:
        """Stages of a grounding step are done once more."""
        self._left |= {key: cost for key, cost in self._costs.items() if key[0] == step and key[1] in names}


def in_words(seconds: float) -> str:
    """``3.2 h``, ``12 min`` or ``40 s``."""
    if seconds >= 5400:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"


def expected_seconds(config: Any, beside: bool = False) -> dict[tuple[int, str], float]:
    """What the stages of a run are expected to cost, on one core of an AMD EPYC (AVX2) with images of 64 pixels.

    Read off runs of the quick configs, by hand; the cost of images goes with their area, that of G with its width
    squared.

    Args:
        config: a :class:`~idapt_pl.run.RunConfig` whose lengths are filled.
        beside: whether work that nothing waits for runs in another process, and costs nothing here.
    """
    costs = step_costs(config, 0) | begin_costs(config, beside)
    every = {(0, name): cost for name, cost in costs.items()}
    for k in range(1, config.schedule.grounding_steps + 1):
        every |= {(k, name): cost for name, cost in step_costs(config, k).items()}
        if beside:
            every.pop((k - 1, "evaluation"), None)
    return {key: cost for key, cost in every.items() if cost > 0 and not (beside and key[1] == "teacher_2")}


def begin_costs(config: Any, beside: bool) -> dict[str, float]:
    """Of what is done before the first grounding step alone: teacher and policy of the plain source, seconds."""
    s, t = config.schedule, config.teacher
    costs = {"source_teacher": 0.008 * t.steps}
    if beside:
        return costs
    return costs | learning_costs(config, s.pretrain, s.source_policy, "source_") | {"direct_transfer": 30.0}


def step_costs(config: Any, k: int) -> dict[str, float]:
    """Of what every grounding step does, seconds."""
    s, t, area = config.schedule, config.teacher, (config.image_size / 64) ** 2
    lengths = s.finetune if k else s.pretrain
    frames = s.interactions if k else s.images
    seen = (s.images + k * s.interactions) if s.accumulate else frames
    looks = config.effects.discover and (not k or config.effects.every_step)
    G = config.modules["visual"]
    costs = {
        "target": 0.004 * frames * area,
        "source": 0.01 * frames * area,
        "replayed": 0.003 * seen * area * (s.paired_steps > 0),
        "convergence": 30.0 * (k > 0 and s.until_settled),
        "state_predictor": 0.002 * config.feeding.state_predictor_batch * lengths.state_predictor * area,
        "visual": 0.1 * config.feeding.visual_batch * lengths.visual * area * (G["width"] / 16) ** 2 * G["blocks"] / 3,
        "translated": 0.004 * seen * area * (lengths.estimator > 0 or t.rehearse > 0),
        "estimator": 0.002 * config.feeding.state_predictor_batch * lengths.estimator * area,
        "control": 0.005 * s.images * looks,
        "effects": 250.0 * looks,
        "known_start_search": 250.0 * (looks and config.effects.refine),
        "dynamics": 0.004 * config.feeding.garat_rollout * lengths.dynamics * (k > 0 and s.action_transformation),
        "teacher": 0.008 * t.adapt * (looks or (k > 0 and s.action_transformation)),
        "evaluation": 50.0,
    }
    if looks and not k and s.repaired_visual:
        again = {name: costs[name] for name in ("source", "replayed", "translated", "estimator")}
        again["visual"] = costs["visual"] * s.repaired_visual / max(lengths.visual, 1)
        costs |= {f"repaired_{name}": cost for name, cost in again.items()}
    costs |= {f"teacher_{i}": costs["teacher"] for i in range(2, t.candidates + 1)}
    if config.poses.spread:
        costs |= {"moved": 0.006 * config.poses.images * area, "moved_translated": 0.004 * config.poses.images * area}
    if config.labels.members:
        costs |= {"reading_errors": 30.0, "lost": 0.00014 * config.labels.members * (s.images + k * s.interactions)}
        costs["reading_offsets"] = 150.0 * config.labels.offsets
    if config.labels.replays:
        costs["estimator_replayed"] = costs["estimator"]
        recorded = s.images + k * s.interactions
        costs |= {"replay_labelled": 0.002 * config.labels.replays * recorded, "replay_agreement": 0.003 * recorded}
    hardened = t.harden > 0 and (not k or costs["teacher"] > 0)  # whenever the teacher is another one
    costs |= learning_costs(config, lengths, lengths.policy, "", 1 if hardened else t.rounds)
    if hardened:
        again = {n: cost for n, cost in learning_costs(config, lengths, 0, "hardened_", t.rounds).items() if "_" in n}
        costs |= again | {"hardened_teacher": 0.008 * t.harden, "trial_rehearsal": costs["rehearsal_policy"]}
    return costs


def learning_costs(config: Any, lengths: Any, policy_steps: int, prefix: str, rounds: int = 1) -> dict[str, float]:
    """Of a policy from images that rehearses so often, seconds."""
    t, area = config.teacher, (config.image_size / 64) ** 2
    costs = {
        "student": 0.03 * t.dagger * area,
        "policy": 0.01 * policy_steps * area * config.feeding.updates_per_step,
    }
    later = (f"policy_{i}" for i in range(2, rounds + 1))
    for part in ("teacher", "policy", *later) if t.rehearse else ():
        costs[f"rehearsal_{part}"] = 0.004 * t.rehearse * area
        costs[f"estimator_{part}"] = 0.001 * config.feeding.state_predictor_batch * lengths.rehearsed * area
        costs[f"filter_{part}"] = 0.02 * lengths.filter
    return {prefix + name: cost for name, cost in costs.items()}
