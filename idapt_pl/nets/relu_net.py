"""A multilayer perceptron with ReLU as one step of autograd, on oneDNN's products where they are quicker.

PyTorch multiplies float32 matrices with MKL, which on AMD's processors keeps to AVX2. Where they have AVX-512, oneDNN,
which PyTorch brings along for convolutions, is nearly twice as quick. Elsewhere it is slower, as it spends some 30 µs
more on every call: on Intel's processors, where MKL takes AVX-512 too, and where there is none. There the layers one by
one on MKL are quickest. ``benchmarks/sac_speed.py`` measures it.
"""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn


def relu_net(net: nn.Sequential, x: Float[Tensor, "n i"], frozen: bool = False) -> Float[Tensor, "n o"]:
    """What ``net(x)`` returns, for linear layers with ReLU between them.

    Args:
        net: as :func:`~idapt_pl.nets.mlp.mlp` makes it.
        x: inputs.
        frozen: gradients flow to ``x`` alone.
    """
    layers = [layer for layer in net if isinstance(layer, nn.Linear)]
    if x.device.type != "cpu" or torch.is_autocast_enabled("cpu") or not onednn_is_quicker():
        return net(x)
    return ReLUNet.apply(x, frozen, *(p for layer in layers for p in (layer.weight, layer.bias)))


@cache
def onednn_is_quicker() -> bool:
    """Whether oneDNN multiplies with wider instructions than MKL may."""
    wide = torch.backends.mkldnn.is_available() and torch.backends.cpu.get_cpu_capability() == "AVX512"
    return wide and not made_by_intel()


def made_by_intel() -> bool:
    """Whether MKL was written for this processor."""
    try:
        return "GenuineIntel" in Path("/proc/cpuinfo").read_text()
    except OSError:  # not Linux
        return "Intel" in platform.processor()


def product(x: Tensor, weight: Tensor, bias: Tensor | None = None, then: str = "none") -> Tensor:
    """X W^T + b by oneDNN, ``then`` "relu" or nothing."""
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, then, [], "")


class ReLUNet(torch.autograd.Function):
    """Linear layers with ReLU between them; parameters are weight and bias of each layer in turn."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, frozen: bool, *parameters: Tensor) -> Tensor:
        ctx.frozen = frozen
        inputs, last = [], len(parameters) - 2
        for i in range(0, len(parameters), 2):
            inputs.append(x)
            x = product(x, parameters[i], parameters[i + 1], "none" if i == last else "relu")
        ctx.save_for_backward(*inputs, *parameters[::2])
        return x

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (g,), saved = gradients, ctx.saved_tensors
        inputs, weights = saved[: len(saved) // 2], saved[len(saved) // 2 :]
        found: list[Tensor | None] = [None] * (2 + 2 * len(weights))
        for i in reversed(range(len(weights))):
            if not ctx.frozen:
                found[2 + 2 * i] = product(g.t(), inputs[i].t())
                found[3 + 2 * i] = g.sum(0)
            if i or ctx.needs_input_grad[0]:
                g = product(g, weights[i].t())
            if i:
                g = torch.ops.aten.threshold_backward(g, inputs[i], 0)
        found[0] = g if ctx.needs_input_grad[0] else None
        return tuple(found)
