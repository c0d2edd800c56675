"""The net in one step is the net layer by layer."""

import pytest
import torch

from idapt_pl.nets import relu_net as module
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.relu_net import relu_net


@pytest.fixture(autouse=True)
def in_one_step(monkeypatch):
    """Also on processors where the layers one by one are quicker."""
    if not torch.backends.mkldnn.is_available():
        pytest.skip("this build of PyTorch has no oneDNN")
    monkeypatch.setattr(module, "onednn_is_quicker", lambda: True)


@pytest.mark.parametrize("hidden", [[32, 16], [8], []])
def test_values_and_gradients_are_those_of_the_layers(hidden):
    net, x = mlp(5, hidden, 3), torch.randn(7, 5, requires_grad=True)
    leaves = [x, *net.parameters()]
    expected, made = net(x), relu_net(net, x)
    torch.testing.assert_close(made, expected)
    for ours, theirs in zip(
        torch.autograd.grad(made.square().sum(), leaves),
        torch.autograd.grad(expected.square().sum(), leaves),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)


def test_a_frozen_net_passes_gradients_on_and_takes_none():
    net, x = mlp(5, [16], 3), torch.randn(7, 5, requires_grad=True)
    relu_net(net, x, frozen=True).sum().backward()
    assert all(p.grad is None for p in net.parameters())
    torch.testing.assert_close(x.grad, torch.autograd.grad(net(x).sum(), x)[0])


def test_where_onednn_is_slower_the_layers_are_computed_one_by_one(monkeypatch):
    net, x = mlp(5, [16], 3), torch.randn(7, 5)
    monkeypatch.setattr(module, "onednn_is_quicker", lambda: False)
    monkeypatch.setattr(module, "product", None)
    assert torch.equal(relu_net(net, x), net(x))


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
