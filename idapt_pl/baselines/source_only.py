"""Policies that know the source alone: direct transfer, and DR (Tobin et al. 2017, Peng et al. 2018)."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from datamodules import Trajectories
from idapt_pl.effects.distribution import listed_effects
from idapt_pl.files import write_yaml
from idapt_pl.grounding import IterativeGrounding
from idapt_pl.rl.collect import collect
from idapt_pl.stages.policy import fit_source_policy
from idapt_pl.stages.schedule import policy_steps
from idapt_pl.stages.state_predictor import fit_P_S


@dataclass(frozen=True)
class SourceOnly:
    """Trains a policy from images in the source, randomised where the config says so, and measures it in the target.

    It takes no step in the target before that. It trains as long as the method's policies do together.

    Attributes:
        grounding: the method, whose settings it has.
    """

    grounding: IterativeGrounding

    def run(self) -> list[dict]:
        """Train and measure. There are no grounding steps to tell of."""
        c, schedule = self.grounding.context, self.grounding.schedule
        if variants := c.worlds.variants:
            write_yaml(c.stages.run_dir / "variants.yaml", [listed_effects(v) for v in variants])
        D_S = (self.explore(),)
        P_S = fit_P_S(c, 0, D_S, schedule.pretrain.state_predictor)
        pi = fit_source_policy(c, policy_steps(schedule), schedule.pretrain, P_S, D_S)
        self.grounding.evaluation.direct_transfer(pi)
        return []

    def explore(self) -> Path:
        """D^S: images and states of the source, every variant for as long as the others."""
        c, s = self.grounding.context, self.grounding.schedule
        steps, worlds = s.source_images or s.images, c.worlds

        def make(seed: int) -> Trajectories:
            about, horizon = f"{worlds.task.name} source, step 0", s.exploration_horizon
            if variants := worlds.variants:
                horizon = max(2, min(horizon or worlds.task.horizon, steps // len(variants)))
            with closing(worlds.training_source(1)) as env:
                return collect(env, self.grounding.explore(seed), steps, seed, about, horizon=horizon)

        return c.stages.record(0, "source", make)[0]
