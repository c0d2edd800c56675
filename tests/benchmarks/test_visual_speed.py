"""The yardstick of the speed benchmark: operations are counted as by hand, and nothing is faster than the machine."""

import importlib
import time

import pytest
import torch
from conftest import ROOT
from torch import nn


@pytest.fixture
def visual_speed(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("visual_speed")


FORWARD = 2 * 2 * 8 * 8 * (8 * 3 * 3 * 3)
"""Of 2 images, 8 x 8 places, 8 x 3 channels, windows of 3 x 3; a product and a sum each."""


def test_operations_of_a_convolution_are_counted_as_by_hand(visual_speed):
    conv, x = nn.Conv2d(3, 8, 3), torch.randn(2, 3, 10, 10, requires_grad=True)
    assert visual_speed.counted_flops(lambda: conv(x)) == FORWARD
    assert visual_speed.counted_flops(lambda: conv(x).sum().backward()) == 3 * FORWARD, "to weights and to the input"
    conv.requires_grad_(False)
    assert visual_speed.counted_flops(lambda: conv(x).sum().backward()) == 2 * FORWARD, "a network that only judges"


def test_operations_of_a_transposed_convolution_are_those_of_its_inputs(visual_speed):
    up, x = nn.ConvTranspose2d(4, 2, 3, stride=2, padding=1, output_padding=1), torch.randn(3, 4, 5, 5)
    assert up(x).shape[-1] == 10
    assert visual_speed.counted_flops(lambda: up(x)) == 2 * 3 * 25 * (4 * 2 * 9)


def test_the_yardsticks_own_operations_are_counted_right(visual_speed):
    for flops, kernel in visual_speed.dense_kernels(torch.device("cpu"), torch.float32):
        assert visual_speed.counted_flops(kernel) == flops


@pytest.mark.slow  # it times, which other work on the machine disturbs
@pytest.mark.parametrize("shape", [(256, 27, 3, 1), (64, 100, 7, 1), (192, 48, 3, 2), (512, 12, 4, 8)])
def test_no_convolution_reaches_more_than_the_machine(visual_speed, shape):
    """Those of a generator's and a discriminator's sizes among them; the first takes most of a step's time."""
    channels, side, kernel, batch = shape
    conv, x = nn.Conv2d(channels, channels, kernel, bias=False), torch.randn(batch, channels, side, side)
    flops, times = visual_speed.counted_flops(lambda: conv(x)), []
    with torch.no_grad():
        for _ in range(7):
            started = time.perf_counter()
            conv(x)
            times.append(time.perf_counter() - started)
    share = flops / sorted(times)[3] / visual_speed.peak_flops(torch.device("cpu"), torch.float32)
    assert 0 < share <= 1
