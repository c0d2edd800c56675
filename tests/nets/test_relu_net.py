"""A net without autograd has the values and the gradients of its layers."""

import pytest
import torch

from idapt_pl.nets import relu_net as module
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.relu_net import linear_layers, relu_net, relu_net_gradients


@pytest.fixture(autouse=True, params=[True, False], ids=["oneDNN", "MKL"])
def products(request, monkeypatch):
    """Of either library, whatever the processor."""
    if request.param and not torch.backends.mkldnn.is_available():
        pytest.skip("this build of PyTorch has no oneDNN")
    monkeypatch.setattr(module, "onednn_is_quicker", lambda: request.param)


@pytest.mark.parametrize("hidden", [[32, 16], [8], []])
def test_values_and_gradients_are_those_of_the_layers(hidden):
    net, x = mlp(5, hidden, 3), torch.randn(7, 5, requires_grad=True)
    layers, expected = linear_layers(net), net(x)
    with torch.no_grad():
        made, inputs = relu_net(layers, x)
        by_x = relu_net_gradients(layers, inputs, 2 * made, of_input=True)
    torch.testing.assert_close(made, expected)
    leaves = [x, *net.parameters()]
    for ours, theirs in zip(
        [by_x, *(p.grad for p in net.parameters())],
        torch.autograd.grad(expected.square().sum(), leaves),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)


@torch.no_grad()
def test_gradients_are_found_only_where_they_are_asked_for():
    net, x = mlp(5, [16], 3), torch.randn(7, 5)
    layers = linear_layers(net)
    made, inputs = relu_net(layers, x)
    before = [torch.full_like(p, 7.0) for p in net.parameters()]
    for p, kept in zip(net.parameters(), before, strict=True):
        p.grad = kept
    by_x = relu_net_gradients(layers, inputs, torch.ones_like(made), of_weights=False, of_input=True)
    assert by_x.shape == x.shape and all(p.grad is kept for p, kept in zip(net.parameters(), before, strict=True))
    assert relu_net_gradients(layers, inputs, torch.ones_like(made)) is None
    torch.testing.assert_close(layers[-1].bias.grad, torch.full((3,), 7.0))  # replaced by a sum over seven rows


@pytest.mark.parametrize(("available", "capability", "intel", "quicker"), [
    (True, "AVX512", False, True), (True, "AVX2", False, False), (False, "AVX512", False, False),
    (True, "AVX512", True, False),
])  # fmt: skip
def test_onednn_multiplies_where_its_instructions_are_wider(monkeypatch, available, capability, intel, quicker):
    monkeypatch.undo()  # the fixture's
    module.onednn_is_quicker.cache_clear()
    monkeypatch.setattr(module, "made_by_intel", lambda: intel)
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: available)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    assert module.onednn_is_quicker() == quicker
    module.onednn_is_quicker.cache_clear()


def test_who_made_the_processor_is_read(monkeypatch):
    kinds = iter(["vendor_id\t: GenuineIntel\n", "vendor_id\t: AuthenticAMD\n"])
    monkeypatch.setattr(module.Path, "read_text", lambda path: next(kinds))
    assert [module.made_by_intel(), module.made_by_intel()] == [True, False]
