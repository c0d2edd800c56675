"""What becomes of images where a visual transformation has learned: there, and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from datamodules import Episode
from datamodules.stacks import FrameStacks
from idapt_pl.modules.manual import ManualModule, fast_precision
from idapt_pl.nets.images import stack_channels, to_pixels
from idapt_pl.nets.translation import ResnetGenerator


class ImageTranslator(ManualModule):
    """Translates images of one domain into the look of another; how it learns to is a subclass's.

    Attributes:
        G: source to target.
        G_back: target to source, if there is a way back.
        G_average: average of G's weights, if one is kept.
    """

    G: ResnetGenerator
    G_back: ResnetGenerator | None
    G_average: AveragedModel | None

    @property
    def frames(self) -> int:
        """How many frames G translates at a time."""
        return 1 if self.hparams.translate == "frame" else self.hparams.frame_stack

    @property
    def translator(self) -> ResnetGenerator:
        """G as it is used after training: the average of its weights, if there is one."""
        return self.G if self.G_average is None else self.G_average.module

    @property
    def backwards(self) -> ResnetGenerator:
        """The way back, target to source.

        Raises:
            ValueError: if there is none.
        """
        if self.G_back is None:
            raise ValueError("this model is one-sided (contrastive): it translates source images to the target only")
        return self.G_back

    @torch.no_grad()
    def translate(self, pixels: np.ndarray) -> np.ndarray:
        """G on frames as an environment gives them: uint8 (n, k, H, W, 3) to the same, k = :attr:`frames`."""
        n, k, h, w, _ = pixels.shape
        with fast_precision(self.device, self.hparams.bf16):
            fake = self.translator(stack_channels(torch.from_numpy(pixels).to(self.device)))
        return to_pixels(fake.unflatten(1, (k, 3))).cpu().numpy().reshape(n, k, h, w, 3)

    def translate_episode(self, episode: Episode) -> Episode:
        """A source episode with images as G shows them; actions and other observations stay as they are."""
        stacks = FrameStacks([episode], self.frames).stacks(np.arange(len(episode) + 1))
        return replace(episode, observations={**episode.observations, "pixels": self.translate(stacks)[:, -1]})

    def translate_stacks(self, pixels: Tensor, back: bool = False) -> Tensor:
        """Whole stacks, uint8 (B, K, H, W, 3) to the same; ``back`` takes target images to the source's look."""
        k = pixels.shape[1]
        net = self.backwards if back else self.translator
        groups = pixels.unflatten(1, (k // self.frames, self.frames)).flatten(0, 1)
        with fast_precision(self.device, self.hparams.bf16):
            fake = net(stack_channels(groups))
        return to_pixels(fake.unflatten(1, (self.frames, 3))).reshape(pixels.shape)

    def validation_step(self, batch: dict, index: int) -> dict[str, Tensor]:
        """Translated stacks of the domains in the batch, for the callbacks that measure and show them."""
        found = {}
        if batch.get("source") is not None:
            found["source"] = self.translate_stacks(batch["source"]["pixels"])
        if batch.get("target") is not None and self.G_back is not None:
            found["target"] = self.translate_stacks(batch["target"]["pixels"], back=True)
        return found

    test_step = validation_step

    def predict_step(self, batch: dict, index: int) -> Tensor:
        """Translated stacks of the one domain in the batch."""
        (domain,) = batch
        return self.translate_stacks(batch[domain]["pixels"], back=domain == "target")
