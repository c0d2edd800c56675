"""G as one file for deployment, images in and images out."""

from __future__ import annotations

import importlib
import io
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from idapt_pl.files import write_atomically
from idapt_pl.modules import VisualTransformation
from idapt_pl.nets.images import stack_channels, to_pixels

SUFFIXES = (".pt2", ".onnx")


class Translator(nn.Module):
    """G between images as cameras give them; nothing of the training is left.

    Args:
        visual: the trained module.
        back: take target images to the source's look.

    Raises:
        ValueError: if the module has no way back.
    """

    def __init__(self, visual: VisualTransformation, back: bool = False) -> None:
        super().__init__()
        self.net, self.frames = visual.backwards if back else visual.translator, visual.frames

    def forward(self, pixels: UInt8[Tensor, "b k h w 3"]) -> UInt8[Tensor, "b k h w 3"]:
        """Translated frames; K is 1, or the whole stack where G sees stacks."""
        return to_pixels(self.net(stack_channels(pixels)).unflatten(1, (self.frames, 3)))


def export_translator(translator: Translator, path: Path) -> None:
    """Write a ``.pt2`` (torch.export) or ``.onnx`` file for any number of images with sides that are multiples of 4.

    Args:
        translator: what is exported.
        path: its ending says the format.

    Raises:
        ValueError: if the ending is another, or a package is missing.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: the ending must be one of {', '.join(SUFFIXES)}, for torch.export or ONNX")
    if path.suffix == ".onnx":
        require_packages("onnx", "onnxscript")
    translator = translator.cpu().eval().requires_grad_(False)
    any_size = {dimension: torch.export.Dim.AUTO for dimension in (0, 2, 3)}
    program = torch.export.export(translator, (example(translator, 2, 32, 48),), dynamic_shapes=(any_size,))
    if path.suffix == ".pt2":
        buffer = io.BytesIO()
        torch.export.save(program, buffer)
        write_atomically(path, lambda temporary: temporary.write_bytes(buffer.getvalue()))
    else:
        onnx = torch.onnx.export(
            program, (), dynamo=True, input_names=["pixels"], output_names=["translated"], verbose=False
        )
        write_atomically(path, lambda temporary: onnx.save(temporary, external_data=False))


def largest_deviation(translator: Translator, path: Path) -> int:
    """Largest difference, in grey levels, between what a file and the module make of random images.

    Raises:
        ValueError: if onnxruntime is missing.
    """
    pixels = example(translator, 3, 64, 40)
    if path.suffix == ".pt2":
        found = torch.export.load(path).module()(pixels)
    else:
        require_packages("onnxruntime")
        session = importlib.import_module("onnxruntime").InferenceSession(path, providers=["CPUExecutionProvider"])
        found = torch.from_numpy(session.run(None, {"pixels": pixels.numpy()})[0])
    return int((found.int() - translator(pixels).int()).abs().max())


def example(translator: Translator, n: int, height: int, width: int) -> Tensor:
    """Random images as the translator takes them, the same each time."""
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (n, translator.frames, height, width, 3), generator=generator, dtype=torch.uint8)


def require_packages(*packages: str) -> None:
    """Say what to install if a package is missing."""
    for name in packages:
        try:
            importlib.import_module(name)
        except ImportError:
            raise ValueError(f"ONNX files need {name}, which is not installed: pip install 'idapt[export]'") from None
