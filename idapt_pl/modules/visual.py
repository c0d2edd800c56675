"""The visual transformation G: CycleGAN with state reconstruction (Section IV-C1, equation 2)."""

from __future__ import annotations

import copy
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torchvision.utils import make_grid

from idapt_pl.losses import GAN_LOSSES
from idapt_pl.modules.image_pool import ImagePool
from idapt_pl.modules.training import ManualModule, fast_precision
from idapt_pl.nets.encoder import PixelStatePredictor, Vision
from idapt_pl.nets.images import jitter, stack_channels, to_float, to_pixels
from idapt_pl.nets.translation import PatchDiscriminator, ResnetGenerator


class VisualTransformation(ManualModule):
    """G: source images to target-style images, trained unpaired, with the state kept by P^T.

    L = L_CycleGAN(o^S, o^T) + λ |P^T(G(o^S)) - s|₁. P^T starts as a copy of P^S and only its first
    convolutions are trained, together with the generators.

    Args:
        state_dim: size of the state vector; 0 trains a plain CycleGAN without state reconstruction.
        image_size: side of the images, pixels; taken from the data.
        frame_stack: K frames in an observation.
        translate: what G sees at a time, one ``frame`` (3 channels) or the whole ``stack`` (3K channels).
        width: channels of the generators' first layer (ngf).
        blocks: residual blocks of the generators.
        discriminator_width: channels of the discriminators' first layer (ndf).
        gan_loss: ``lsgan`` (CycleGAN) or ``bce`` (the authors' code: smoothed labels on the mean logit).
        pool_size: history of fakes for the discriminators; 0 for none.
        cycle_weight: of the cycle-consistency loss, on images in -1..1.
        identity_weight: of |G(o^T) - o^T|, against colour inversion; 0 leaves it out.
        state_weight: λ, on standardised states.
        state_jitter: how much contrast, brightness and noise of translated images vary before P^T sees them, so that G
            cannot please it with faint patterns (adversarial examples) instead of placing things. 0 as in the paper.
        reset_weight: of |G(o^S) - o^T| between first observations of episodes. Where both domains are reset alike,
            those show the same state up to the reset noise, and say where G has to place things, which unpaired
            images of domains that move differently leave open. 0 leaves it out (the paper).
        finetune_convs: how many first convolutions of P^T are trained (1 in the paper, 2 in the code).
        lr_generator: Adam, generators and P^T.
        lr_discriminator: Adam, discriminators.
        betas: Adam.
        vision: how images are looked at; the same for all modules.
        rates: state component to the component it is the rate of; taken from the task.
        dt: control period, s; taken from the task.
        bf16: bfloat16 autocast.
        images_every: batches between image grids in TensorBoard.
    """

    def __init__(
        self,
        state_dim: int,
        image_size: int,
        frame_stack: int = 3,
        vision: Vision = Vision(),
        rates: dict[int, int] | None = None,
        dt: float = 1.0,
        translate: Literal["frame", "stack"] = "frame",
        width: int = 64,
        blocks: int = 9,
        discriminator_width: int = 64,
        gan_loss: Literal["lsgan", "bce"] = "lsgan",
        pool_size: int = 50,
        cycle_weight: float = 10.0,
        identity_weight: float = 5.0,
        state_weight: float = 5.0,
        state_jitter: float = 0.0,
        reset_weight: float = 0.0,
        finetune_convs: int = 1,
        lr_generator: float = 2e-4,
        lr_discriminator: float = 2e-4,
        betas: tuple[float, float] = (0.5, 0.999),
        bf16: bool = True,
        images_every: int = 200,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["vision", "rates"])
        if image_size % 4:
            raise ValueError(f"image_size must be divisible by 4 for the ResNet generator, got {image_size}")
        channels = 3 if translate == "frame" else 3 * frame_stack
        self.G = ResnetGenerator(channels, width, blocks)  # source to target
        self.G_back = ResnetGenerator(channels, width, blocks)  # target to source
        self.D_T = PatchDiscriminator(channels, discriminator_width)
        self.D_S = PatchDiscriminator(channels, discriminator_width)
        self.P_T = None
        if state_dim:
            self.P_T = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)
        self.pools = {"source": ImagePool(pool_size), "target": ImagePool(pool_size)}

    @property
    def frames(self) -> int:
        """How many frames G translates at a time."""
        return 1 if self.hparams.translate == "frame" else self.hparams.frame_stack

    def adopt(self, P_S: PixelStatePredictor) -> None:
        """Copy P^S into P^T and leave only the first ``finetune_convs`` convolutions trainable."""
        self.P_T = copy.deepcopy(P_S)
        self.P_T.requires_grad_(False)
        self.P_T.encoder.convs[: self.hparams.finetune_convs].requires_grad_(True)

    @torch.no_grad()
    def translate(self, pixels: np.ndarray) -> np.ndarray:
        """G on frames as an environment gives them: uint8 (n, k, H, W, 3) to the same, k = :attr:`frames`."""
        n, k, h, w, _ = pixels.shape
        with fast_precision(self.device, self.hparams.bf16):
            fake = self.G(stack_channels(torch.from_numpy(pixels).to(self.device)))
        return to_pixels(fake.unflatten(1, (k, 3))).cpu().numpy().reshape(n, k, h, w, 3)

    def training_step(self, batch: dict, index: int) -> None:
        opt_g, opt_d = self.optimizers()
        real_S, real_T = self.adversarial_input(batch["source"]), self.adversarial_input(batch["target"])
        with self.toggled_optimizer(opt_g), fast_precision(self.device, self.hparams.bf16):
            fake_S, fake_T, parts = self.generator_losses(real_S, real_T, batch["source"], self.resets(batch))
            self.descend(opt_g, sum(parts.values()))
        with self.toggled_optimizer(opt_d), fast_precision(self.device, self.hparams.bf16):
            d_T = self.discriminator_loss(self.D_T, real_T, self.pools["target"](fake_T))
            d_S = self.discriminator_loss(self.D_S, real_S, self.pools["source"](fake_S))
            self.descend(opt_d, d_T + d_S)
        for schedule in self.lr_schedulers():
            schedule.step()
        self.log_at(
            index, {**{f"visual/{k}": v for k, v in parts.items()}, "visual/d_target": d_T, "visual/d_source": d_S}
        )
        if index % self.hparams.images_every == 0:
            self.log_grid(batch, index)

    def adversarial_input(self, batch: dict[str, Tensor]) -> Tensor:
        """What the GAN losses see: the newest frame of each stack, or the whole stack as channels."""
        return stack_channels(batch["pixels"][:, -self.frames :])

    def resets(self, batch: dict[str, dict[str, Tensor]]) -> tuple[Tensor | None, Tensor | None]:
        """First observations of episodes, source and target: pairs up to the reset noise."""
        if not self.hparams.reset_weight:
            return None, None
        return self.adversarial_input(batch["source_resets"]), self.adversarial_input(batch["target_resets"])

    def generator_losses(
        self,
        real_S: Tensor,
        real_T: Tensor,
        source: dict[str, Tensor],
        resets: tuple[Tensor | None, Tensor | None] = (None, None),
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Weighted generator losses of equation (2), and the fakes for the discriminators.

        Args:
            real_S: source images, (B, C, H, W), -1..1.
            real_T: target images.
            source: the source's whole stacks and states.
            resets: images of first observations, source and target, with ``reset_weight``.
        """
        w = self.hparams
        gan = GAN_LOSSES[w.gan_loss]
        # One pass through each net for all that goes in: the batch is cheaper than the calls.
        older = self.older_frames(source)
        same_S, same_T = (real_S, real_T) if w.identity_weight else (None, None)
        to_T = through(self.G, {"S": real_S, "T": same_T, "older": older, "reset": resets[0]})
        to_S = through(self.G_back, {"T": real_T, "S": same_S, "reset": resets[1]})
        fake_T, fake_S = to_T["S"], to_S["T"]
        parts = {"g_target": gan(self.D_T(fake_T), True), "g_source": gan(self.D_S(fake_S), True)}
        parts["cycle"] = w.cycle_weight * (
            (self.G_back(fake_T) - real_S).abs().mean() + (self.G(fake_S) - real_T).abs().mean()
        )
        if w.identity_weight:
            parts["identity"] = w.identity_weight * (
                (to_T["T"] - real_T).abs().mean() + (to_S["S"] - real_S).abs().mean()
            )
        if w.reset_weight:
            parts["reset"] = w.reset_weight * (
                (to_T["reset"] - resets[1]).abs().mean() + (to_S["reset"] - resets[0]).abs().mean()
            )
        if self.P_T is not None and w.state_weight:
            translated = self.whole_stack(fake_T, to_T["older"])
            parts["state"] = w.state_weight * self.P_T.error(jitter(translated, w.state_jitter), source["state"])
        return fake_S, fake_T, parts

    def older_frames(self, source: dict[str, Tensor]) -> Tensor | None:
        """The frames that only state reconstruction needs: the older ones, if P^T looks at a stack and G at a frame."""
        needs = self.frames == 1 and self.P_T is not None and not self.P_T.rates and self.hparams.state_weight
        return to_float(source["pixels"][:, :-1]).flatten(0, 1) if needs else None

    def whole_stack(self, newest: Tensor, older: Tensor | None) -> Tensor:
        """Translated stack (B, 3K, H, W) from its newest frame and the older ones."""
        if older is None:
            return newest
        older = older.unflatten(0, (len(newest), -1))
        return torch.cat([older, newest[:, None]], 1).flatten(1, 2)

    def discriminator_loss(self, D: torch.nn.Module, real: Tensor, fake: Tensor) -> Tensor:
        """Half of real-against-fake, so that D learns at half the generators' pace (CycleGAN, sec. 4)."""
        gan = GAN_LOSSES[self.hparams.gan_loss]
        return 0.5 * (gan(D(real), True) + gan(D(fake), False))

    @torch.no_grad()
    def log_grid(self, batch: dict, index: int) -> None:
        """A TensorBoard image with the rows source, G(source), cycle, target, G_back(target)."""
        if self.logger is None:
            return
        S, T = (self.adversarial_input(batch[d])[:4] for d in ("source", "target"))
        with fast_precision(self.device, self.hparams.bf16):
            fake = self.G(S)
            rows = torch.cat([S, fake, self.G_back(fake), T, self.G_back(T)])
        grid = make_grid(rows[:, -3:].float().cpu() / 2 + 0.5, nrow=len(S))
        self.logger.experiment.add_image("visual/source_translated_cycled_target_back", grid, index)

    def configure_optimizers(self) -> tuple[list, list]:
        w = self.hparams
        trainable = [*self.G.parameters(), *self.G_back.parameters()]
        if self.P_T is not None:
            trainable += [p for p in self.P_T.parameters() if p.requires_grad]
        opt_g = torch.optim.Adam(trainable, lr=w.lr_generator, betas=tuple(w.betas), fused=True)
        discriminators = [*self.D_T.parameters(), *self.D_S.parameters()]
        opt_d = torch.optim.Adam(discriminators, lr=w.lr_discriminator, betas=tuple(w.betas), fused=True)

        def constant_then_linear(step: int) -> float:  # CycleGAN: the second half decays to zero
            return min(1.0, 2.0 * (1.0 - self.share_done(step)))

        return [opt_g, opt_d], [torch.optim.lr_scheduler.LambdaLR(o, constant_then_linear) for o in (opt_g, opt_d)]


def through(net: torch.nn.Module, parts: dict[str, Tensor | None]) -> dict[str, Tensor | None]:
    """Images of several kinds through a net in one pass; None stays None."""
    given = {name: images for name, images in parts.items() if images is not None}
    out = net(torch.cat(list(given.values()))).split([len(images) for images in given.values()])
    return dict.fromkeys(parts) | dict(zip(given, out, strict=True))
