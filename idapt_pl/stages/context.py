"""What every stage of a run shares: its worlds, its folder, its settings, its teacher."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.stage import Stages
from idapt_pl.stages.distillation import Distillation
from idapt_pl.stages.settings import BatchSettings, FilterSettings, LabelSettings, ModuleFactories, PoseSettings
from idapt_pl.worlds import Worlds


@dataclass(frozen=True)
class StageContext:
    """What every stage of a run shares.

    Attributes:
        worlds: source, grounded source, and the target as each part may see it.
        stages: the run folder; runs a stage or loads it.
        make: constructors of the modules.
        batches: sizes of batches and rollouts.
        teacher: the privileged teacher of the run; off unless the config asks for one.
        filter: how the policy's filter learns, if it has one.
        labels: how images of the target get states to learn from, if they do.
        poses: in which poses beside those of motions the source is seen.
    """

    worlds: Worlds
    stages: Stages
    make: ModuleFactories
    batches: BatchSettings
    teacher: Distillation
    filter: FilterSettings = field(default_factory=FilterSettings)
    labels: LabelSettings = field(default_factory=LabelSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)

    def new_policy(self, start: AsymmetricSAC | PixelStatePredictor | None = None) -> AsymmetricSAC:
        """A policy: as ``start`` is, or new, with an encoder from a predictor if one is given."""
        module = self.make.policy(**self.worlds.dimensions, **self.worlds.action_bounds)
        if isinstance(start, PixelStatePredictor):
            module.start_from(start)
        elif start is not None:
            module.load_state_dict(start.state_dict())
        return module


def continued(build: Callable[[], torch.nn.Module], initial: torch.nn.Module | None) -> Callable:
    """A builder whose module starts with the weights of ``initial`` (fresh optimizers, by design)."""

    def build_continued() -> torch.nn.Module:
        module = build()
        if initial is not None:
            module.load_state_dict(initial.state_dict())
        return module

    return build_continued
