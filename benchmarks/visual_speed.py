"""How fast does the visual transformation train and translate, against a plain PyTorch loop of the same networks?

    python benchmarks/visual_speed.py [--presets paper official fast] [--sizes 100 256] [--device cpu] [--rounds 3]

Prints tables and writes ``results/visual_training.csv`` and ``results/visual_inference.csv``; rows of other presets,
sizes and devices stay. All rows of one preset
and size are measured in turns within one run, and their medians are compared.

The reference loop is what one writes first, after the CycleGAN paper: float32, one pass for each thing that goes
through a network, the generators' step before the discriminators', PyTorch's own layers, floats from the loader, in
memory as torchvision's transforms give them. The others are
`idapt visual`: the same losses and batch through Trainer and data module, without loggers, with

- ``float32``: all that goes through a network in one pass, bytes until the device, fused Adam, and on CPUs norms by the
  kernel of group norm and a last convolution with channels last;
- ``bfloat16``: and autocast, where the device computes in it; ``channels_last``, ``compiled``: and those. Compiling for
  a CPU takes minutes, so these variants are measured there only if named.

``waiting`` is the share of the time that the loop waits for data. ``share_of_peak`` is the arithmetic of a step
(counted by PyTorch's FLOP counter) over what the same device does, with as many threads and in turns with the steps, in
the fastest of some matrix products and convolutions of that precision.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  prepares torchvision before Lightning loads
import imageio.v3 as iio
import lightning as L
import numpy as np
import torch
import yaml
from rendering import write_table
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset
from torch.utils.flop_counter import FlopCounterMode

from datamodules.images import ImageDomains
from idapt_pl.losses import GAN_LOSSES
from idapt_pl.modules import VisualTransformation
from idapt_pl.modules.image_pool import ImagePool
from idapt_pl.modules.manual import computes_bfloat16
from idapt_pl.nets.translation import InstanceNorm, PatchDiscriminator, ResnetGenerator

VARIANTS = {
    "float32": ("32-true", {}),
    "float32 channels_last": ("32-true", {"channels_last": True}),
    "bfloat16": ("bf16-mixed", {}),
    "bfloat16 channels_last": ("bf16-mixed", {"channels_last": True}),
    "bfloat16 compiled": ("bf16-mixed", {"compile_nets": True}),
    "bfloat16 channels_last compiled": ("bf16-mixed", {"channels_last": True, "compile_nets": True}),
}
REFERENCE = ("32-true", {})
KEY = ("preset", "size", "device")
"""Rows that are measured together, whose ratios mean something, stay together."""
WARM_UP = 3
"""Steps before the clock runs (more where networks are compiled: the first steps compile)."""


def preset(name: str) -> tuple[dict, int]:
    """Constructor arguments of a preset, and its batch size."""
    config = yaml.safe_load((ROOT / "configs" / "visual" / f"{name}.yaml").read_text())
    return config["model"], config["data"]["batch_size"]


def suits(variant: str, device: torch.device) -> bool:
    """Whether a variant is worth measuring on a device."""
    precision, options = VARIANTS[variant]
    if precision == "bf16-mixed" and not computes_bfloat16(device):
        return False
    return device.type == "cuda" or not options.get("compile_nets")


def synchronized(device: torch.device) -> float:
    """Now, s, once the device has done its work."""
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


# --- the reference ------------------------------------------------------------------------------------------


class PlainLoop:
    """CycleGAN in plain PyTorch, with the settings of a preset; no state reconstruction."""

    def __init__(self, settings: dict, source: Tensor, target: Tensor, batch: int, device: torch.device) -> None:
        self.s, self.device = settings, device
        width, blocks, d_width = (settings[k] for k in ("width", "blocks", "discriminator_width"))
        self.G, self.F = (plain_generator(width, blocks).to(device) for _ in range(2))
        self.D_S, self.D_T = (plain_layers(PatchDiscriminator(3, d_width).body).to(device) for _ in range(2))
        g, d = (itertools.chain(a.parameters(), b.parameters()) for a, b in ((self.G, self.F), (self.D_S, self.D_T)))
        self.opt_g = torch.optim.Adam(g, settings["lr_generator"], (0.5, 0.999))
        self.opt_d = torch.optim.Adam(d, settings["lr_discriminator"], (0.5, 0.999))
        self.gan, pool = GAN_LOSSES[settings.get("gan_loss", "lsgan")], settings.get("pool_size", 50)
        self.pools = ImagePool(pool), ImagePool(pool)
        load = [DataLoader(TensorDataset(x), batch, shuffle=True, drop_last=True) for x in (source, target)]
        self.batches = zip(*map(endless, load), strict=True)

    def step(self) -> None:
        """One training step."""
        (S,), (T,) = next(self.batches)
        S, T = S.to(self.device), T.to(self.device)
        for p in itertools.chain(self.D_S.parameters(), self.D_T.parameters()):
            p.requires_grad_(False)
        fake_T, fake_S = self.G(S), self.F(T)
        loss = self.gan(self.D_T(fake_T), True) + self.gan(self.D_S(fake_S), True)
        cycle = (self.F(fake_T) - S).abs().mean() + (self.G(fake_S) - T).abs().mean()
        loss = loss + self.s.get("cycle_weight", 10.0) * cycle
        if self.s.get("identity_weight", 5.0):
            identity = (self.G(T) - T).abs().mean() + (self.F(S) - S).abs().mean()
            loss = loss + self.s.get("identity_weight", 5.0) * identity
        self.opt_g.zero_grad()
        loss.backward()
        self.opt_g.step()
        for p in itertools.chain(self.D_S.parameters(), self.D_T.parameters()):
            p.requires_grad_(True)
        self.opt_d.zero_grad()
        for D, real, fake in ((self.D_T, T, self.pools[0](fake_T)), (self.D_S, S, self.pools[1](fake_S))):
            (0.5 * (self.gan(D(real), True) + self.gan(D(fake), False))).backward()
        self.opt_d.step()

    def seconds(self, steps: int) -> tuple[float, float]:
        """Median time of a step, s; of waiting nothing is known."""
        for _ in range(WARM_UP):
            self.step()
        times = []
        for _ in range(steps):
            started = synchronized(self.device)
            self.step()
            times.append(synchronized(self.device) - started)
        return statistics.median(times), float("nan")


def plain_generator(width: int, blocks: int) -> nn.Module:
    """The generator of PyTorch's own layers."""
    return nn.Sequential(plain_layers(ResnetGenerator(3, width, blocks).body), nn.Tanh())


def plain_layers(net: nn.Module) -> nn.Module:
    """A network with PyTorch's instance norm in place of ours."""
    for name, child in net.named_children():
        if isinstance(child, InstanceNorm):
            setattr(net, name, nn.InstanceNorm2d(child.num_features, affine=True))
        else:
            plain_layers(child)
    return net


def endless(loader: DataLoader):
    """Batches for ever."""
    while True:
        yield from loader


# --- ours ---------------------------------------------------------------------------------------------------


class Clock(L.Callback):
    """Times of whole steps and of the waiting for data in each."""

    def __init__(self, warm_up: int) -> None:
        self.warm_up, self.ends, self.waits = warm_up, [], []

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: dict, index: int) -> None:
        if self.ends:
            self.waits.append(time.perf_counter() - self.ends[-1])

    def on_train_batch_end(self, trainer: L.Trainer, module: L.LightningModule, *args: object) -> None:
        self.ends.append(synchronized(module.device))

    @property
    def seconds(self) -> tuple[float, float]:
        """Median time of a step, and of it the waiting, s."""
        steps = np.diff(self.ends)[self.warm_up :]
        return float(np.median(steps)), float(np.median(self.waits[self.warm_up :]))


def trained(settings: dict, variant: str, data: ImageDomains, device: torch.device, steps: int) -> tuple[float, float]:
    """Median time of a step of ours, and of it the waiting for data, s."""
    precision, options = VARIANTS[variant]
    clock = Clock(3 * WARM_UP if options.get("compile_nets") else WARM_UP)
    module = VisualTransformation(**settings | options, bf16=False, **data.dimensions)
    trainer = L.Trainer(
        accelerator="gpu" if device.type == "cuda" else "cpu",
        devices=1,
        precision=precision,
        max_epochs=1000,
        max_steps=2 * (steps + clock.warm_up + 1),  # two optimizers
        callbacks=[clock],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(module, datamodule=data)
    return clock.seconds


def step_flops(settings: dict, size: int, batch: int) -> float:
    """Floating-point operations of a training step, in products and sums, as the reference makes it."""
    images = torch.rand(batch, 3, size, size) * 2 - 1
    loop = PlainLoop(settings, images, images, batch, torch.device("cpu"))
    return counted_flops(loop.step)


def counted_flops(action: Callable[[], object]) -> float:
    """Floating-point operations of a call: two for each product that is added, in whole windows at borders too."""
    with FlopCounterMode(display=False) as counter:
        action()
    return counter.get_total_flops()


def dense_kernels(device: torch.device, dtype: torch.dtype) -> list[tuple[float, Callable[[], object]]]:
    """What a device is good at: floating-point operations of a call, counted by hand, and the call."""
    made, kernels = {"device": device, "dtype": dtype}, []
    for n in (4096, 8192) if device.type == "cuda" else (1024, 2048):
        a, b = torch.randn(n, n, **made), torch.randn(n, n, **made)
        kernels.append((2.0 * n**3, lambda a=a, b=b: a @ b))
    for channels, side, kernel in ((256, 32, 3), (128, 64, 3), (512, 32, 1)):
        batch = 32 if device.type == "cuda" else 4
        x = torch.randn(batch, channels, side, side, **made)
        conv, places = nn.Conv2d(channels, channels, kernel, bias=False, **made), (side - kernel + 1) ** 2
        kernels.append((2.0 * batch * places * channels**2 * kernel**2, lambda x=x, conv=conv: conv(x)))
    return kernels


@torch.no_grad()
def peak_flops(device: torch.device, dtype: torch.dtype, calls: int = 5) -> float:
    """Operations a second of the fastest dense kernel at its best: matrix products and convolutions, some sizes each.

    Products alone are no bound: for AMD's processors with AVX-512 MKL keeps to AVX2, and oneDNN's convolutions do not.
    """
    best = 0.0
    for flops, kernel in dense_kernels(device, dtype):
        kernel()
        for _ in range(calls):
            started = synchronized(device)
            kernel()
            best = max(best, flops / (synchronized(device) - started))
    return best


def training_rows(name: str, size: int, device: torch.device, o: argparse.Namespace) -> list[dict]:
    """Images a second in training, reference and variants in turns."""
    settings, batch = preset(name)
    n = max(64, 4 * batch)
    with tempfile.TemporaryDirectory() as folder:
        pixels = write_noise(Path(folder), n, size)
        data = ImageDomains(root=folder, batch_size=batch)
        data.setup("fit")
        source, target = (x.movedim(-1, 1).contiguous().float() / 127.5 - 1 for x in pixels)
        plain = PlainLoop(settings, source, target, batch, device)
        times: dict[str, list[tuple[float, float]]] = {"reference": []} | {v: [] for v in o.variants}
        dtypes = {v: torch.float32 if VARIANTS.get(v, REFERENCE)[0] == "32-true" else torch.bfloat16 for v in times}
        peaks = dict.fromkeys(dtypes.values(), 0.0)
        for _ in range(o.rounds):
            for dtype in peaks:
                peaks[dtype] = max(peaks[dtype], peak_flops(device, dtype))
            times["reference"].append(plain.seconds(o.steps))
            for variant in o.variants:
                times[variant].append(trained(settings, variant, data, device, o.steps))
    flops, rows = step_flops(settings, size, batch), []
    reference = statistics.median(t for t, _ in times["reference"])
    for variant, measured in times.items():
        seconds = statistics.median(t for t, _ in measured)
        waiting = statistics.median(w for _, w in measured)
        rows.append(
            {
                "preset": name, "size": size, "batch": batch, "device": device.type, "variant": variant,
                "step_ms": round(1e3 * seconds, 1), "images_per_second": round(batch / seconds, 2),
                "times_reference": round(reference / seconds, 2),
                "waiting": "" if waiting != waiting else round(waiting / seconds, 4),
                "gflop_step": round(flops / 1e9, 1),
                "share_of_peak": round(flops / seconds / peaks[dtypes[variant]], 3),
            }
        )  # fmt: skip
    return rows


def write_noise(folder: Path, n: int, size: int) -> list[Tensor]:
    """Two folders of n images each, and the images, uint8 (n, size, size, 3)."""
    rng, sets = np.random.default_rng(0), []
    for name in ("trainA", "trainB"):
        images = rng.integers(0, 256, (n, size, size, 3), np.uint8)
        (folder / name).mkdir()
        for i, image in enumerate(images):
            iio.imwrite(folder / name / f"{i}.png", image)
        sets.append(torch.from_numpy(images))
    return sets


# --- inference ----------------------------------------------------------------------------------------------


def rate(action: Callable[[], object], device: torch.device, calls: int) -> float:
    """Median time of a call, s."""
    times = []
    for _ in range(calls + 2):
        started = synchronized(device)
        action()
        times.append(synchronized(device) - started)
    return statistics.median(times[2:])


@torch.no_grad()
def inference_rows(name: str, size: int, device: torch.device, o: argparse.Namespace) -> list[dict]:
    """G between environment and policy: NumPy bytes in and out, at batches of 1 and 16."""
    settings, _ = preset(name)
    rows = []
    for batch in (1, 16):
        pixels = np.random.default_rng(0).integers(0, 256, (batch, 1, size, size, 3), np.uint8)
        plain = plain_generator(settings["width"], settings["blocks"]).to(device).eval()
        actions = {"reference": lambda plain=plain, pixels=pixels: translate_plainly(plain, pixels, device)}
        for variant in o.variants:
            precision, options = VARIANTS[variant]
            settings_of = settings | options | {"translate": "frame", "bf16": precision.startswith("bf16")}
            module = VisualTransformation(0, size, 1, **settings_of).to(device).eval()
            actions[variant] = lambda module=module, pixels=pixels: module.translate(pixels)
        times = {variant: [] for variant in actions}
        for _, (variant, action) in itertools.product(range(o.rounds), actions.items()):
            times[variant].append(rate(action, device, o.steps))
        reference = statistics.median(times["reference"])
        for variant, measured in times.items():
            seconds = statistics.median(measured)
            what = {"preset": name, "size": size, "batch": batch, "device": device.type, "variant": variant}
            speed = {"call_ms": round(1e3 * seconds, 2), "images_per_second": round(batch / seconds, 1)}
            rows.append(what | speed | {"times_reference": round(reference / seconds, 2)})
    return rows


def translate_plainly(G: nn.Module, pixels: np.ndarray, device: torch.device) -> np.ndarray:
    """Bytes to bytes in float32."""
    images = torch.from_numpy(pixels[:, 0]).to(device).permute(0, 3, 1, 2).contiguous().float() / 127.5 - 1
    return ((G(images) + 1) * 127.5).round().clamp(0, 255).byte().permute(0, 2, 3, 1).cpu().numpy()


def main() -> None:
    """Measure everything."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--presets", nargs="+", default=["paper", "official", "fast"])
    p.add_argument("--sizes", nargs="+", type=int, default=[100, 256])
    p.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    p.add_argument("--variants", nargs="+", choices=VARIANTS, help="default: those that suit the device")
    p.add_argument("--rounds", type=int, default=3, help="turns of each loop; their median counts")
    p.add_argument("--steps", type=int, default=10, help="timed steps in each turn")
    p.add_argument("--dry", action="store_true", help="print only, write no file")
    o = p.parse_args()
    warnings.filterwarnings("ignore")
    device = torch.device(o.device)
    o.variants = o.variants or [v for v in VARIANTS if suits(v, device)]
    for name, size in itertools.product(o.presets, o.sizes):
        training, inference = training_rows(name, size, device, o), inference_rows(name, size, device, o)
        if o.dry:
            print(*training, *inference, sep="\n", flush=True)
        else:
            write_table("visual_training", training, KEY)
            write_table("visual_inference", inference, KEY)


if __name__ == "__main__":
    main()
