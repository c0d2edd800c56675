"""Machines that are drawn: a seed is a machine, what is hidden shows, and answers are matched one to one."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.drawn.hidden import KINDS, Hidden, Place  # noqa: E402
from benchmarks.drawn.machine import draw_machine  # noqa: E402
from benchmarks.drawn_machines import HOW_MANY, SEEN, draw, matches, record, shown  # noqa: E402


def test_a_seed_is_a_machine():
    (one, hidden, data), (other, _, again) = draw(3), draw(3)
    assert one.to_xml() == other.to_xml() != draw(4)[0].to_xml()
    assert len(hidden) == HOW_MANY[3]
    for a, b in zip(data, again, strict=True):
        np.testing.assert_array_equal(a.observations["qpos"], b.observations["qpos"])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_what_is_hidden_changes_what_is_seen_and_nothing_else_does(kind):
    rng = np.random.default_rng(1)
    spec, steps = draw_machine(rng)
    model = spec.compile()
    places = (
        Place(model, steps * model.opt.timestep, rng, b, b - 1, (b - 1) % model.nu) for b in range(1, model.nbody)
    )
    sizes = [shown(spec, steps, h, rng) for h in map(kind, places) if h is not None]
    assert max(sizes) > SEEN
    assert shown(spec, steps, Hidden("nothing", ""), rng) < 1e-6


def test_what_is_hidden_is_not_left_in_the_model():
    rng = np.random.default_rng(1)
    spec, steps = draw_machine(rng)
    before = spec.to_xml()
    model = spec.compile()
    for kind in KINDS:
        h = kind(Place(model, steps * model.opt.timestep, rng, 1, 0, 0))
        if h is not None:
            record(spec, steps, [h], np.random.default_rng(0))
    assert spec.to_xml() == before and spec.compile().dof_damping.tolist() == model.dof_damping.tolist()


def test_each_hidden_thing_needs_a_finding_of_its_own():
    a, b = Hidden("joint_damping", "x"), Hidden("body_mass", "y")
    assert matches([a, b], [{("joint_damping", "x")}, {("body_mass", "y"), ("body_com", "y")}]) == 2
    assert matches([a, b], [{("joint_damping", "x"), ("body_mass", "y")}]) == 1, "one finding stands for one thing"
    assert matches([a], [{("joint_damping", "z")}]) == 0
    assert matches([], [{("joint_damping", "x")}]) == 0
