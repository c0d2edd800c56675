"""Imitation: an image policy's actor, regressed on what a teacher would do."""

from __future__ import annotations

import torch
import torch.nn.functional as nnf
from torch import Tensor

from idapt_pl.modules.manual import ManualModule
from idapt_pl.modules.policy import AsymmetricSAC
from idapt_pl.modules.sac import unstack


class Imitation(ManualModule):
    """Fits ``policy.actor`` to a teacher's mean actions and spread; the critics are left as they are.

    Actions are compared after tanh, where -1..1 is the action range: how far beyond it a mean lies changes nothing. The
    spread is compared before tanh, as its logarithm, so that SAC goes on exploring as the teacher did.

    Args:
        policy: whose actor learns. With a supervised encoder its head alone does, and the encoder goes on estimating.
        spread_weight: weight of the squared error of the log standard deviation.
    """

    def __init__(self, policy: AsymmetricSAC, spread_weight: float = 0.01) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["policy"])
        self.policy = policy

    def training_step(self, batch: dict[str, dict[str, Tensor]], index: int) -> None:
        """One environment step's updates: ``transitions`` and ``images`` are (updates, minibatch, ...)."""
        metrics: dict[str, Tensor | float] = {}
        for minibatch in unstack(batch["transitions"]):
            metrics |= self.actor_step(minibatch)
        for minibatch in unstack(batch.get("images", {})):
            metrics |= self.estimator_step(minibatch)
        self.lr_schedulers().step()
        if (index + 1) % self.trainer.log_every_n_steps == 0:  # what nobody writes down costs time
            share = {"imitation/teacher_share": self.trainer.datamodule.act.share}
            self.log_at(index, metrics | share | self.trainer.datamodule.progress())

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Descend on E|tanh μ - label|² + w E(log σ - log σ_teacher)²."""
        mean, log_std = self.policy.actor.gaussian(self.policy.features(batch["observation"]))
        error = nnf.mse_loss(mean.tanh(), batch["label"])
        spread = nnf.mse_loss(log_std, batch["label_log_std"])
        self.descend(self.optimizers(), error + self.hparams.spread_weight * spread)
        return {"imitation/action_error": error.detach(), "imitation/spread_error": spread.detach()}

    def estimator_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress f(o) on the source state, as when SAC trains."""
        loss = self.policy.estimator_loss(batch)
        self.descend(self.optimizers(), loss)
        return {"policy/state_error": loss.detach()}

    def configure_optimizers(self) -> tuple[list, list]:
        """One optimizer: with a supervised encoder, either loss reaches its own part of the actor and no other."""
        w, actor = self.policy.hparams, self.policy.actor
        lr_encoder = w.lr_estimator if w.encoder == "supervised" else w.lr
        groups = [{"params": actor.head.parameters(), "lr": w.lr}]
        groups.append({"params": actor.encoder.parameters(), "lr": lr_encoder})

        def linear(step: int) -> float:
            return 1.0 - self.share_done(step)

        optimizer = torch.optim.Adam(groups, fused=True)
        return [optimizer], [torch.optim.lr_scheduler.LambdaLR(optimizer, linear)]
