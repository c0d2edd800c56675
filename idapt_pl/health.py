"""Whether training is sound: numbers that are none end it, losses that run away are noted."""

from __future__ import annotations

import logging
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import lightning as L
import torch
from torch import nn

log = logging.getLogger(__name__)

NO_LOSSES = {"step", "epoch", "policy/episode_return", "policy/transitions", "imitation/teacher_share"}
"""Logged numbers that say how far training is; a return is NaN until the first episode has ended."""

RUNS_AWAY = 10.0
"""A loss whose last tenth lies so many times above its early median has run away."""
USUAL = 0.3
"""Losses start at about this or more, being of standardised states, images in -1..1 and logits."""
FAR_ABOVE = 1e3
"""A loss this large at the end has run away, also where it did so before anything was logged."""
FEWEST_VALUES = 8
"""Logged values below which there is no early and late."""
BEYOND_REWARDS = 3.0
"""Values so many times above what the largest reward, forever, is worth are no values."""

FREE = (
    "policy/actor_loss",
    "policy/critic_loss",
    "policy/q",
    "policy/entropy",
    "policy/temperature",
    "dynamics/entropy",
)
"""What follows the returns, or has no scale of its own: healthy critics' losses grow a thousandfold with the values."""

SETTINGS_OF = {
    "StatePredictor": "state_predictor",
    "VisualTransformation": "visual",
    "ActionTransformation": "dynamics",
    "AsymmetricSAC": "policy",
    "Imitation": "policy",
    "FilterTraining": "filter",
}
"""The config's key for what each module is made with; others have no learning rate that a config sets."""


class NotFinite(RuntimeError):
    """A loss or a weight is NaN or infinite.

    Args:
        where: what was trained.
        found: the loss or weight.
        cure: which setting to look at.
    """

    def __init__(self, where: str, found: str, cure: str) -> None:
        super().__init__(f"{where}: {found}, so it ends here and these weights are not kept. {cure}")


def check_weights(module: nn.Module, where: str, cure: str) -> None:
    """Look at all weights and buffers; ``where`` and ``cure`` are for the message.

    Raises:
        NotFinite: if one is NaN or infinite.
    """
    tensors = {name: t for name, t in module.state_dict().items() if t.is_floating_point()}
    if bad := [name for name, t in tensors.items() if not torch.isfinite(t).all()]:
        found = f"{len(bad)} of {len(tensors)} tensors of weights are not finite, first {bad[0]}"
        raise NotFinite(where, found, cure)


class Health(L.Callback):
    """Watches a fit: stops it at the first loss or weight that is not finite, and finds losses that run away.

    Losses are looked at where they are logged, weights at some ten points and at the end of every epoch.

    Args:
        where: what is trained, for messages, such as ``step 0, stage visual``.
        settings: the config's key for the module's settings; None: that of ``idapt fit``.
    """

    def __init__(self, where: str, settings: str | None = None) -> None:
        self.where, self.settings = where, settings
        self.seen: dict[str, list[float]] = defaultdict(list)
        self._batches = 0

    def on_train_batch_end(
        self, trainer: Any, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        self._batches += 1
        if self._batches % trainer.log_every_n_steps:
            return
        for name, value in trainer.callback_metrics.items():
            if name not in NO_LOSSES and not name.startswith("quality/"):  # PSNR may be infinite
                self.seen[name].append(float(value))
                if not torch.isfinite(value):
                    found = f"{name} is {float(value)} after {self._batches} batches"
                    raise NotFinite(self.where, found, self.cure(pl_module))
        if self._batches % (25 * trainer.log_every_n_steps) == 0:
            check_weights(pl_module, self.where, self.cure(pl_module))

    def on_train_epoch_end(self, trainer: Any, pl_module: L.LightningModule) -> None:
        check_weights(pl_module, self.where, self.cure(pl_module))

    @contextmanager
    def explaining(self, module: nn.Module) -> Iterator[None]:
        """Around a fit: whatever fails because of weights that are not finite is told as that."""
        try:
            yield
        except (ValueError, RuntimeError) as error:
            check_weights(module, self.where, self.cure(module))
            if "to satisfy the constraint" in str(error):  # torch, of a distribution's parameters
                raise NotFinite(self.where, "a distribution's spread is 0 or none", self.cure(module)) from error
            raise

    def cure(self, module: nn.Module) -> str:
        """Which settings to look at."""
        settings = self.settings or SETTINGS_OF.get(type(module).__name__)
        if settings is None:
            return "Try another --seed"
        hparams = getattr(module, "policy", module).hparams  # Imitation trains a policy with its rates
        rates = [f"{settings}.{k} (now {v:g})" for k, v in hparams.items() if k.startswith("lr") and k != "lr_floor"]
        return f"Look at {' and '.join(rates)}: a lower one, in a new --run_dir, most often helps"

    def running_away(self, module: L.LightningModule, data: L.LightningDataModule) -> list[str]:
        """What has run away though it stayed finite, in words; warns of each.

        Args:
            module: as it was trained.
            data: that it was trained on; SAC's has a replay buffer.
        """
        found = [
            f"{name} ended at {last:.3g}, after {early:.3g} early on"
            for name, (early, last) in early_and_late(self.seen).items()
            if name not in FREE and (last > RUNS_AWAY * max(early, USUAL) or last > FAR_ABOVE)
        ]
        if values := self.seen.get("policy/q"):
            rewards = data.buffer.sample(data.buffer.size, names=("rewards",))["rewards"]
            largest, value = worth(module.hparams, rewards), abs(values[-1])
            if value > BEYOND_REWARDS * largest:
                found.append(f"policy/q ended at {value:.3g}, and the rewards are worth {largest:.3g} at most")
        for words in found:
            log.warning("%s: %s. %s", self.where, words, self.cure(module))
        return found


def early_and_late(series: Mapping[str, list[float]]) -> dict[str, tuple[float, float]]:
    """The median size of each series in its first quarter and in its last tenth; those too short are left out."""
    sizes = {name: [abs(v) for v in values] for name, values in series.items() if len(values) >= FEWEST_VALUES}
    return {
        name: (statistics.median(v[: len(v) // 4]), statistics.median(v[-max(1, len(v) // 10) :]))
        for name, v in sizes.items()
    }


def worth(settings: Mapping[str, Any], rewards: Any) -> float:
    """What the largest reward (or cost of training) is worth if it never ends; 1 stands for the entropy's."""
    costs = settings.get("action_cost", 0.0) + settings.get("unfamiliarity_cost", 0.0)
    return (1 + costs + float(abs(rewards).max())) / max(1 - settings["gamma"], 1e-3)
