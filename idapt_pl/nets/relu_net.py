"""A multilayer perceptron with ReLU without autograd: its values, and its gradients written out.

Autograd spends more time on small nets than their products take (``benchmarks/sac_speed.py``). It has to be off
(``torch.no_grad``) where these functions are called.

PyTorch multiplies float32 matrices with MKL, which on AMD's processors keeps to AVX2. Where they have AVX-512, oneDNN,
which PyTorch brings along for convolutions, is nearly twice as quick. Elsewhere it is slower, as it spends some 30 µs
more on every call: on Intel's processors, where MKL takes AVX-512 too, and where there is none.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import torch
import torch.nn.functional as nnf
from jaxtyping import Float
from torch import Tensor, nn


def linear_layers(net: nn.Sequential) -> list[nn.Linear]:
    """The linear layers of a net as :func:`~idapt_pl.nets.mlp.mlp` makes it; there is a ReLU between any two."""
    return [layer for layer in net if isinstance(layer, nn.Linear)]


def relu_net(layers: Sequence[nn.Linear], x: Float[Tensor, "n i"]) -> tuple[Float[Tensor, "n o"], list[Tensor]]:
    """What a net makes of x, and what each of its layers was given."""
    inputs, last = [], len(layers) - 1
    for i, layer in enumerate(layers):
        inputs.append(x)
        x = product(x, layer.weight, layer.bias, relu=i < last)
    return x, inputs


def relu_net_gradients(
    layers: Sequence[nn.Linear],
    inputs: Sequence[Tensor],
    g: Float[Tensor, "n o"],
    of_weights: bool = True,
    of_input: bool = False,
) -> Float[Tensor, "n i"] | None:
    """Backpropagate through a net.

    Args:
        layers: of the net.
        inputs: as :func:`relu_net` gave them.
        g: gradient of a loss by the net's output.
        of_weights: set ``grad`` of weights and biases (what was there is replaced).
        of_input: go on to the net's input.

    Returns:
        The gradient by the net's input, if asked for.
    """
    for i in reversed(range(len(layers))):
        weight, bias = layers[i].weight, layers[i].bias
        if of_weights:
            weight.grad, bias.grad = product(g.t(), inputs[i].t()), g.sum(0)
        if i or of_input:
            g = product(g, weight.t())
        if i:
            g = torch.ops.aten.threshold_backward(g, inputs[i], 0)
    return g if of_input else None


def product(x: Tensor, weight: Tensor, bias: Tensor | None = None, relu: bool = False) -> Tensor:
    """X W^T + b, and ReLU of it."""
    if x.device.type == "cpu" and onednn_is_quicker():
        return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "relu" if relu else "none", [], "")
    out = nnf.linear(x, weight, bias)
    return out.relu_() if relu else out


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
