"""The visual transformation G: CycleGAN with state reconstruction (Section IV-C1, equation 2)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torchvision.utils import make_grid

from idapt_pl.checkpoints import read_checkpoint
from idapt_pl.files import blaming
from idapt_pl.losses import GAN_LOSSES, flicker, patch_nce
from idapt_pl.modules.image_pool import ImagePool
from idapt_pl.modules.manual import fast_precision
from idapt_pl.modules.translator import ImageTranslator
from idapt_pl.modules.weight_average import warmed_up_average
from idapt_pl.nets.contrastive import PatchProjector
from idapt_pl.nets.encoder import PixelStatePredictor, Vision
from idapt_pl.nets.images import height_width, in_one_pass, jitter, mean_images, stack_channels, to_float
from idapt_pl.nets.translation import PatchDiscriminator, ResnetGenerator

SMALLEST = 24
"""Side of the smallest images from which a PatchGAN has more than one place left to normalise over, pixels."""


class VisualTransformation(ImageTranslator):
    """G: source images to target-style images, trained unpaired, with the state kept by P^T.

    L = L_CycleGAN(o^S, o^T) + λ |P^T(G(o^S)) - s|₁. P^T starts as a copy of P^S and only its first
    convolutions are trained, together with the generators.

    With ``contrastive_weight`` and no ``cycle_weight`` it is one-sided (CUT, Park et al. 2020): there is no way back
    and no source discriminator, and patches of a translated image must be closest to those they were made of.

    Args:
        state_dim: size of the state vector; 0 trains a plain CycleGAN without state reconstruction.
        image_size: side of the images, or height and width, pixels; taken from the data.
        frame_stack: K frames in an observation.
        translate: what G sees at a time, one ``frame`` (3 channels) or the whole ``stack`` (3K channels).
        width: channels of the generators' first layer (ngf).
        blocks: residual blocks of the generators.
        background: generators begin as the mean image of the domain they translate to, and learn what differs from it;
            for cameras that stand still, or move with the robot. False as in CycleGAN.
        discriminator_width: channels of the discriminators' first layer (ndf).
        discriminator_layers: their layers of stride 2 (n_layers_D); 3 judge patches of 70 pixels, 2 of 34, 1 of 16.
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
        contrastive_weight: of the patches' contrastive loss; 0 leaves it out.
        consistency_weight: of flicker of what stands still, between the frames of a stack; 0 leaves it out.
        ema_decay: G is used as the exponential moving average of its weights, for example 0.999; 0 uses it as it is.
        finetune_convs: how many first convolutions of P^T are trained (1 in the paper, 2 in the code).
        lr_generator: Adam, generators and P^T.
        lr_discriminator: Adam, discriminators.
        betas: Adam.
        vision: how images are looked at; the same for all modules.
        rates: state component to the component it is the rate of; taken from the task.
        dt: control period, s; taken from the task.
        bf16: bfloat16 autocast, where the device computes in it.
        channels_last: keep the networks' weights with channels last, which convolutions on GPUs prefer.
        compile_nets: compile the networks with torch.compile (the first batches then take a minute or more).
        images_every: batches between image grids in TensorBoard.
    """

    two_ways = False

    def __init__(
        self,
        state_dim: int,
        image_size: int | Sequence[int],
        frame_stack: int = 3,
        vision: Vision = Vision(),
        rates: dict[int, int] | None = None,
        dt: float = 1.0,
        translate: Literal["frame", "stack"] = "frame",
        width: int = 64,
        blocks: int = 9,
        background: bool = False,
        discriminator_width: int = 64,
        discriminator_layers: int = 3,
        gan_loss: Literal["lsgan", "bce"] = "lsgan",
        pool_size: int = 50,
        cycle_weight: float = 10.0,
        identity_weight: float = 5.0,
        state_weight: float = 5.0,
        state_jitter: float = 0.0,
        reset_weight: float = 0.0,
        contrastive_weight: float = 0.0,
        consistency_weight: float = 0.0,
        ema_decay: float = 0.0,
        finetune_convs: int = 1,
        lr_generator: float = 2e-4,
        lr_discriminator: float = 2e-4,
        betas: tuple[float, float] = (0.5, 0.999),
        bf16: bool = True,
        channels_last: bool = False,
        compile_nets: bool = False,
        images_every: int = 200,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["vision", "rates"])
        self.save_hyperparameters({"vision": asdict(vision), "rates": dict(rates or {})})
        if any(side % 4 for side in height_width(image_size)):
            raise ValueError(f"image_size must be divisible by 4 for the ResNet generator, got {image_size}")
        if min(height_width(image_size)) < SMALLEST:
            raise ValueError(
                f"images must have at least {SMALLEST} pixels a side for the discriminators, got {image_size}"
            )
        if consistency_weight and frame_stack < 2:
            raise ValueError("consistency_weight compares the frames of a stack, and frame_stack is 1: leave it at 0")
        channels = 3 if translate == "frame" else 3 * frame_stack
        self.one_sided = contrastive_weight > 0 and cycle_weight == 0
        generator = partial(ResnetGenerator, channels, width, blocks, height_width(image_size) if background else None)
        self.G = generator()  # source to target
        self.G_back = None if self.one_sided else generator()  # target to source
        patches = (channels, discriminator_width, discriminator_layers)
        self.D_T = PatchDiscriminator(*patches)
        self.D_S = None if self.one_sided else PatchDiscriminator(*patches)
        self.P_T: PixelStatePredictor | None = None
        if state_dim:
            self.P_T = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)
        self.pools = {"source": ImagePool(pool_size), "target": ImagePool(pool_size)}
        self.nce_layers = sorted({0, 1, 2, 3, 3 + blocks // 2})  # convolutions, first and middle residual block
        self.H = PatchProjector([width * min(2**i, 4) for i in self.nce_layers]) if contrastive_weight else None
        self.G_average = None
        if ema_decay:
            self.G_average = AveragedModel(self.G, multi_avg_fn=partial(warmed_up_average, ema_decay))
            self.G_average.requires_grad_(False)
        self.prepare_nets(channels_last, compile_nets)

    @classmethod
    def from_checkpoint(cls, path: Path) -> VisualTransformation:
        """The trained module of a checkpoint, ready for use (weights only, nothing is unpickled).

        Raises:
            ValueError: if there is no such file, or it is damaged or no checkpoint of a visual transformation.
        """
        if not path.is_file():
            raise ValueError(f"{path}: no such checkpoint; train one first: idapt visual fit")
        cure = "Expected a checkpoint of a visual transformation; train one: idapt visual fit"
        with blaming(path, cure):
            saved = read_checkpoint(path, cure)
            settings = dict(saved["hyper_parameters"])
            module = cls(**settings | {"vision": Vision(**settings["vision"])})
            module.load_state_dict(saved["state_dict"])
        return module.eval()

    @property
    def estimator(self) -> PixelStatePredictor:
        """P^T, where there is a state to estimate."""
        assert self.P_T is not None, "this model was made without a state: state_dim is 0"
        return self.P_T

    def prepare_nets(self, channels_last: bool, compile_nets: bool) -> None:
        """Memory layout and compilation, which change speed and nothing else."""
        nets: tuple[torch.nn.Module | None, ...] = (self.G, self.G_back, self.D_T, self.D_S)
        for net in filter(None, nets):
            if channels_last:
                net.to(memory_format=torch.channels_last)
            if compile_nets:
                net.compile(dynamic=False)

    def adopt(self, P_S: PixelStatePredictor) -> None:
        """Copy P^S into P^T and leave only the first ``finetune_convs`` convolutions trainable."""
        self.P_T = copy.deepcopy(P_S)
        self.P_T.requires_grad_(False)
        self.P_T.encoder.convs[: self.hparams.finetune_convs].requires_grad_(True)

    def on_fit_start(self) -> None:
        """Set the backgrounds of new generators from the training images."""
        if self.G.background is None or self.G.background.any():  # else a fit that goes on
            return
        means = mean_images(self.trainer.datamodule.train_dataloader(), self.frames)
        self.G.start_from(means["target"].to(self.device))
        if self.G_back is not None:
            self.G_back.start_from(means["source"].to(self.device))
        if self.G_average is not None:
            self.G_average.module.load_state_dict(self.G.state_dict())

    def training_step(self, batch: dict, index: int) -> None:
        opt_g, opt_d = self.optimizers()
        real_S, real_T = self.adversarial_input(batch["source"]), self.adversarial_input(batch["target"])
        resets = self.resets(batch)
        # Toggled: networks that only judge keep no activations for gradients of their own weights.
        with self.toggled_optimizer(opt_g):
            ways = [partial(self.way_there, real_S, real_T, batch["source"], resets)]
            if self.G_back is not None:
                ways.append(partial(self.way_back, real_S, real_T, resets))
            (fake_T, parts), *back = self.descend_each(opt_g, ways, self.hparams.bf16)
        if self.G_average is not None:
            self.G_average.update_parameters(self.G)
        judged = [partial(self.judged, "d_target", self.D_T, real_T, self.pools["target"](fake_T))]
        for fake_S, parts_back in back:
            assert self.D_S is not None  # there is a way back
            parts |= {name: loss + parts.get(name, 0.0) for name, loss in parts_back.items()}
            judged.append(partial(self.judged, "d_source", self.D_S, real_S, self.pools["source"](fake_S)))
        with self.toggled_optimizer(opt_d):
            for _, losses in self.descend_each(opt_d, judged, self.hparams.bf16):
                parts |= losses
        for schedule in self.lr_schedulers():
            schedule.step()
        step = self.trainer.current_epoch * self.trainer.num_training_batches + index
        self.log_at(step, {f"visual/{k}": v for k, v in parts.items()})
        if step % self.hparams.images_every == 0:
            self.log_grid(batch, step)

    def adversarial_input(self, batch: dict[str, Tensor]) -> Tensor:
        """What the GAN losses see: the newest frame of each stack, or the whole stack as channels."""
        return stack_channels(batch["pixels"][:, -self.frames :])

    def resets(self, batch: dict[str, dict[str, Tensor]]) -> tuple[Tensor | None, Tensor | None]:
        """First observations of episodes, source and target: pairs up to the reset noise."""
        if not self.hparams.reset_weight:
            return None, None
        if "source_resets" not in batch:
            raise ValueError(
                "reset_weight needs first observations of episodes, which these data do not have: set it to 0"
            )
        return self.adversarial_input(batch["source_resets"]), self.adversarial_input(batch["target_resets"])

    def way_there(
        self, real_S: Tensor, real_T: Tensor, source: dict[str, Tensor], resets: tuple[Tensor | None, Tensor | None]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The part of equation (2) that begins with G: G(o^S) and its weighted losses.

        Args:
            real_S: source images, (B, C, H, W), -1..1.
            real_T: target images.
            source: the source's whole stacks and states.
            resets: images of first observations, source and target, with ``reset_weight``.
        """
        w = self.hparams
        # One pass through the net for all that goes in: the batch is cheaper than the calls.
        older, same = self.older_frames(source), real_T if w.identity_weight else None
        made = in_one_pass(self.G, {"translated": real_S, "same": same, "older": older, "reset": resets[0]})
        fake_T = made["translated"]
        parts = {"g_target": GAN_LOSSES[w.gan_loss](self.D_T(fake_T), True)}
        parts |= self.image_losses(made, self.G_back, real_S, real_T, resets[1])
        if w.contrastive_weight:
            parts["contrastive"] = w.contrastive_weight * self.contrast(fake_T, real_S)
        return fake_T, parts | self.stack_losses(self.whole_stack(fake_T, made["older"]), source)

    def way_back(
        self, real_S: Tensor, real_T: Tensor, resets: tuple[Tensor | None, Tensor | None]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The part that begins with G_back: target images made source images, and their weighted losses."""
        same = real_S if self.hparams.identity_weight else None
        made = in_one_pass(self.backwards, {"translated": real_T, "same": same, "reset": resets[1]})
        fake_S = made["translated"]
        assert self.D_S is not None  # there is a way back
        parts = {"g_source": GAN_LOSSES[self.hparams.gan_loss](self.D_S(fake_S), True)}
        return fake_S, parts | self.image_losses(made, self.G, real_T, real_S, resets[0])

    def image_losses(
        self, made: dict, other: ResnetGenerator | None, real: Tensor, there: Tensor, reset: Tensor | None
    ) -> dict[str, Tensor]:
        """Weighted L1 losses between images: the cycle, images that should stay as they are, first observations.

        Args:
            made: what a generator made: ``translated`` of images that it is for, ``same`` of images that are already of
                the domain it translates to, and ``reset`` of first observations; or None.
            other: takes ``translated`` back; None leaves the cycle out.
            real: what ``translated`` was made of.
            there: images of the domain it translates to.
            reset: first observations of that domain.
        """
        pairs = {"identity": (made["same"], there), "reset": (made["reset"], reset)}
        if other is not None:
            pairs["cycle"] = (other(made["translated"]), real)
        return {
            name: self.hparams[f"{name}_weight"] * (image - wanted).abs().mean()
            for name, (image, wanted) in pairs.items()
            if image is not None
        }

    def stack_losses(self, translated: Tensor, source: dict[str, Tensor]) -> dict[str, Tensor]:
        """Weighted losses on whole translated stacks (B, 3K, H, W): state reconstruction, flicker."""
        w, parts = self.hparams, {}
        if self.P_T is not None and w.state_weight:
            parts["state"] = w.state_weight * self.P_T.error(jitter(translated, w.state_jitter), source["state"])
        if w.consistency_weight:
            frames = [x.unflatten(1, (-1, 3)) for x in (translated, stack_channels(source["pixels"]))]
            parts["consistency"] = w.consistency_weight * flicker(*frames)
        return parts

    def contrast(self, fake_T: Tensor, real_S: Tensor) -> Tensor:
        """Mean contrastive loss of patches over the layers that :attr:`H` looks at (CUT, eq. 4)."""
        queries, keys = (self.G.features(x, self.nce_layers) for x in (fake_T, real_S))
        assert self.H is not None  # made with contrastive_weight
        pairs = self.H(queries, keys)
        return sum(patch_nce(query, key) for query, key in pairs) / len(pairs)

    def older_frames(self, source: dict[str, Tensor]) -> Tensor | None:
        """The frames that only losses on whole stacks need: the older ones, if G sees one frame at a time."""
        w = self.hparams
        for_state = self.P_T is not None and not self.P_T.rates and w.state_weight
        if self.frames > 1 or not (for_state or w.consistency_weight):
            return None
        return to_float(source["pixels"][:, :-1]).flatten(0, 1)

    def whole_stack(self, newest: Tensor, older: Tensor | None) -> Tensor:
        """Translated stack (B, 3K, H, W) from its newest frame and the older ones."""
        if older is None:
            return newest
        older = older.unflatten(0, (len(newest), -1))
        return torch.cat([older, newest[:, None]], 1).flatten(1, 2)

    def judged(self, name: str, D: PatchDiscriminator, real: Tensor, fake: Tensor) -> tuple[None, dict[str, Tensor]]:
        """Half of real-against-fake, under a name, so that D learns at half the generators' pace (CycleGAN, sec. 4).

        One pass for both, for speed: instance norm keeps images apart.
        """
        gan = GAN_LOSSES[self.hparams.gan_loss]
        on_real, on_fake = D(torch.cat([real, fake])).split([len(real), len(fake)])
        return None, {name: 0.5 * (gan(on_real, True) + gan(on_fake, False))}

    @torch.no_grad()
    def log_grid(self, batch: dict, index: int) -> None:
        """A TensorBoard image with the rows source, G(source), cycle, target, G_back(target)."""
        if not isinstance(self.logger, TensorBoardLogger):
            return
        S, T = (self.adversarial_input(batch[d])[:4] for d in ("source", "target"))
        with fast_precision(self.device, self.hparams.bf16):
            fake = self.G(S)
            rows = [S, fake, T] if self.G_back is None else [S, fake, self.G_back(fake), T, self.G_back(T)]
        grid = make_grid(torch.cat(rows)[:, -3:].float().cpu() / 2 + 0.5, nrow=len(S))
        name = "source_translated_target" if self.one_sided else "source_translated_cycled_target_back"
        self.logger.experiment.add_image(f"visual/{name}", grid, index)

    def on_save_checkpoint(self, checkpoint: dict) -> None:
        """Past fakes are part of a run that goes on."""
        checkpoint["pools"] = {name: pool.images for name, pool in self.pools.items()}

    def on_load_checkpoint(self, checkpoint: dict) -> None:
        for name, images in checkpoint.get("pools", {}).items():
            self.pools[name].images = [image.to(self.device) for image in images]

    def configure_optimizers(self) -> tuple[list, list]:
        w = self.hparams
        trainable = []
        nets: tuple[torch.nn.Module | None, ...] = (self.G, self.G_back, self.P_T, self.H)
        for net in filter(None, nets):
            trainable += [p for p in net.parameters() if p.requires_grad]
        opt_g = torch.optim.Adam(trainable, lr=w.lr_generator, betas=tuple(w.betas), fused=True)
        discriminators = [p for D in filter(None, (self.D_T, self.D_S)) for p in D.parameters()]
        opt_d = torch.optim.Adam(discriminators, lr=w.lr_discriminator, betas=tuple(w.betas), fused=True)

        def constant_then_linear(step: int) -> float:  # CycleGAN: the second half decays to zero
            return min(1.0, 2.0 * (1.0 - self.share_done(step)))

        return [opt_g, opt_d], [torch.optim.lr_scheduler.LambdaLR(o, constant_then_linear) for o in (opt_g, opt_d)]
