"""Deployment faults of what nothing holds: no joint tells its clock, and its motors may be in any order."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from datamodules import Trajectories, read_trajectories

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed

from benchmarks.undeclared.cases import CASES
from benchmarks.undeclared.generate import generate
from idapt_pl.deployment_faults.fault import FaultKind
from idapt_pl.deployment_faults.find import find_deployment_faults


@pytest.fixture(scope="module")
def quadrotor(tmp_path_factory):
    """A model, and flights in which nothing is wrong."""
    nominal, measured = generate(CASES["control_quadrotor"], 0, tmp_path_factory.mktemp("quadrotor"))
    return mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)


def test_nothing_is_found_in_a_flight_as_it_was(quadrotor):
    assert find_deployment_faults(*quadrotor).faults == ()


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_another_control_period_is_found(quadrotor, factor):
    model, data = quadrotor
    (fault,) = find_deployment_faults(model, Trajectories(data.episodes, factor * data.dt)).faults
    assert fault.kind is FaultKind.CONTROL_PERIOD and fault.estimate == pytest.approx(1 / factor)


def test_motors_in_another_order_are_found(quadrotor):
    model, data = quadrotor
    order = [2, 0, 3, 1]
    episodes = tuple(replace(e, actions=e.actions[:, order]) for e in data)
    (fault,) = find_deployment_faults(model, replace(data, episodes=episodes)).faults
    names = [a.name for a in model.actuators]
    assert fault.kind is FaultKind.COMMAND_ORDER
    assert fault.estimate == tuple(names[i] for i in np.argsort(order))
