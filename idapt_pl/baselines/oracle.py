"""The oracle: what SAC reaches when it may train in the target. A reference, no part of the method."""

from __future__ import annotations

from contextlib import closing

import torch
from gymnasium.vector import VectorEnv

from datamodules import Trajectories
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.rl.collect import collect
from idapt_pl.run_folder.interactions import ORACLE, ORACLE_EVALUATION, oracle_interactions
from idapt_pl.stages.policy import fit_policy
from idapt_pl.stages.schedule import policy_steps
from idapt_pl.stages.state_predictor import fit_P_S


def train_oracle(grounding: IterativeGrounding) -> dict:
    """Train and evaluate a policy in the target, with its images, state and reward.

    It trains as long as the method's policies did together. Its interactions are entered in the ledger
    under a purpose of their own.

    Returns:
        As of :meth:`~idapt_pl.evaluation.evaluation.Evaluation.target_return`.
    """
    c, schedule = grounding.context, grounding.schedule
    worlds, stages = c.worlds, c.stages
    steps = policy_steps(schedule)

    def make_env(device: torch.device) -> VectorEnv:
        return worlds.rewarded_target(c.batches.num_envs)

    def collect_labelled(seed: int) -> Trajectories:
        with closing(worlds.rewarded_target(1)) as env:
            return collect(env, grounding.explore(seed), schedule.images, seed, "oracle reference")

    path, _ = stages.record(0, "oracle", collect_labelled)
    predictor = fit_P_S(c, 0, [path], schedule.pretrain.state_predictor, None, "oracle_predictor")
    policy = fit_policy(c, 0, "oracle", make_env, steps, predictor.P_S, [path])
    taken = oracle_interactions(path, c.batches.num_envs, c.batches.warmup_steps)
    worlds.ledger.enter(0, ORACLE, taken)
    result = stages.measure(0, "oracle_evaluation", lambda seed: grounding.evaluation.target_return(policy, seed))
    worlds.ledger.enter(0, ORACLE_EVALUATION, result["interactions"])
    return result
