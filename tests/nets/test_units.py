"""Nets that are told in other units go on computing what they did."""

import copy

import pytest
import torch

from idapt_pl.nets.devices import on_device
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.state_filter import StateFilter
from idapt_pl.nets.units import Units

BEFORE = Units(torch.tensor([0.5, -2.0, 0.1]), torch.tensor([0.3, 4.0, 1.5]))
NOW = Units(torch.tensor([-0.2, 1.0, 0.1]), torch.tensor([0.9, 2.0, 1.0]))


def states_with(units, n=400):
    """States that have this mean and spread, as nearly as numbers allow."""
    x = torch.randn(n, len(units.mean))
    return (x - x.mean(0)) / x.std(0) * units.std + units.mean


@pytest.mark.parametrize("rates", ["learned", "differences", "frames"])
def test_a_predictor_with_another_scale_predicts_the_same_states(rates):
    torch.manual_seed(0)
    net = Vision(strides=(2, 2, 1, 1), rates=rates).predictor(24, 3, 3, {2: 0}, 0.1)
    if rates == "frames":
        torch.nn.init.normal_(net.motion[-1].weight, std=0.1)  # a new net adds nothing
    net.fit_scale(states_with(BEFORE))
    torch.testing.assert_close(Units.of(net).std, BEFORE.std)
    pixels = torch.randint(0, 255, (5, 3, 24, 24, 3), dtype=torch.uint8)
    expected, standardised = net.predict(pixels), net.encode(pixels)
    net.fit_scale(states_with(NOW))
    torch.testing.assert_close(Units.of(net).std, NOW.std)
    torch.testing.assert_close(net.predict(pixels), expected, rtol=1e-4, atol=1e-4)
    assert (net.encode(pixels) - standardised).abs().max() > 0.1, "but in other units"


def test_a_new_predictor_takes_the_scale_and_keeps_its_weights():
    torch.manual_seed(0)
    net = Vision(strides=(2, 2, 1, 1)).predictor(24, 1, 3, {}, 0.1)
    weights = copy.deepcopy(net.mlp.state_dict())
    net.fit_scale(states_with(BEFORE))
    assert all(torch.equal(weights[k], v) for k, v in net.mlp.state_dict().items())


def test_a_filter_makes_the_same_of_readings_in_other_units():
    torch.manual_seed(0)
    known = StateFilter(3, 2, hidden=16)
    torch.nn.init.normal_(known.correction[-1].weight, std=0.3)
    known.learn_usual_correction(torch.randn(50, 3))
    told = copy.deepcopy(known)
    told.tell_in_units(BEFORE, NOW)
    states, actions = states_with(BEFORE, 4 * 6).view(4, 6, 3), torch.rand(4, 6, 2)

    def estimates(net, units):
        readings = (states - units.mean) / units.std
        standardised, hidden = net(readings, actions, torch.zeros(4, 16))
        return standardised * units.std + units.mean, hidden, net.lost(readings[:, -1], standardised[:, -1])

    for a, b in zip(estimates(known, BEFORE), estimates(told, NOW), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


def test_a_module_lent_to_a_stage_stays_where_it_is():
    module, there = torch.nn.Linear(2, 2), torch.device("meta")
    assert on_device(module, torch.device("cpu")) is module
    assert on_device(module, there).weight.device == there and module.weight.device.type == "cpu"
