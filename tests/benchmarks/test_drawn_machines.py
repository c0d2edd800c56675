"""Machines that are drawn: a seed is a machine, what is hidden shows, and answers are matched one to one."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.drawn.crawler import draw_crawler  # noqa: E402
from benchmarks.drawn.hidden import KINDS, ON_A_FLOOR, Hidden, Place  # noqa: E402
from benchmarks.drawn.machine import draw_machine  # noqa: E402
from benchmarks.drawn_machines import HOW_MANY, SEEN, draw, matches, record, shown  # noqa: E402


def test_a_seed_is_a_machine():
    (one, hidden, data), (other, _, again) = draw(3), draw(3)
    assert one.to_xml() == other.to_xml() != draw(4)[0].to_xml()
    assert len(hidden) == HOW_MANY[3]
    for a, b in zip(data, again, strict=True):
        np.testing.assert_array_equal(a.observations["qpos"], b.observations["qpos"])


WHERE = [(draw_machine, kind) for kind in KINDS] + [(draw_crawler, kind) for kind in ON_A_FLOOR]


@pytest.mark.parametrize(("draw_one", "kind"), WHERE, ids=lambda f: f.__name__)
def test_what_is_hidden_changes_what_is_seen_and_nothing_else_does(draw_one, kind):
    rng = np.random.default_rng(1)
    machine = draw_one(rng)
    sizes = [shown(machine, h, rng) for h in hidden_everywhere(machine, kind, rng) if h is not None]
    assert max(sizes) > SEEN
    assert shown(machine, Hidden("nothing", ""), rng) < 1e-6


def hidden_everywhere(machine, kind, rng):
    """One thing of a kind at every joint."""
    model = machine.spec.compile()
    for v in range(machine.first_joint, model.nv):
        body = model.jnt_bodyid[v]
        yield kind(Place(model, machine.period, rng, int(body), v, (v - machine.first_joint) % model.nu))


@pytest.mark.parametrize("draw_one", [draw_machine, draw_crawler])
def test_what_is_hidden_is_not_left_in_the_model(draw_one):
    machine = draw_one(np.random.default_rng(1))
    before, model = machine.spec.to_xml(), machine.spec.compile()
    for kind in machine.kinds:
        for h in hidden_everywhere(machine, kind, np.random.default_rng(1)):
            if h is not None:
                record(machine, [h], np.random.default_rng(0))
    assert machine.spec.to_xml() == before and machine.spec.compile().dof_damping.tolist() == model.dof_damping.tolist()


def test_a_crawler_begins_on_the_floor_and_no_motor_moves_its_trunk():
    machine = draw_crawler(np.random.default_rng(2))
    model = machine.spec.compile()
    driven = {int(j) for j in model.actuator_trnid[:, 0]}
    assert driven == set(range(machine.first_joint, model.nv))
    for x, _ in record(machine, [], np.random.default_rng(0)):
        data = mujoco.MjData(model)
        data.qpos[:] = x[0, : model.nq]
        mujoco.mj_forward(model, data)
        assert data.ncon == 0 and x[:, 1].min() < x[0, 1], "above the floor at first, falling onto it"


def test_each_hidden_thing_needs_a_finding_of_its_own():
    a, b = Hidden("joint_damping", "x"), Hidden("body_mass", "y")
    assert matches([a, b], [{("joint_damping", "x")}, {("body_mass", "y"), ("body_com", "y")}]) == 2
    assert matches([a, b], [{("joint_damping", "x"), ("body_mass", "y")}]) == 1, "one finding stands for one thing"
    assert matches([a], [{("joint_damping", "z")}]) == 0
    assert matches([], [{("joint_damping", "x")}]) == 0
