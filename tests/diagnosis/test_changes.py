"""Effects that change while they are recorded: found with their values, and none where nothing changes."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from idapt_pl.diagnosis.answer import changes
from idapt_pl.diagnosis.answer.change_statistics import WindowTimes, constancy_test, scores_of, time_shapes
from idapt_pl.diagnosis.answer.changes import find_changes
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, refit_accepted
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointStribeck

sys.path.insert(0, str(ROOT / "tests" / "report"))
from test_diagnosis_report import MOTOR, NOMINAL, SWING, record


def recordings(*dampings, episodes=5):
    """The nominal model, and recordings of one swing in their order, so many episodes with each damping."""
    each = [record(d, episodes=episodes) for d in dampings]
    data = replace(each[0], episodes=tuple(e for part in each for e in part))
    return mujoco.MjSpec.from_string(SWING.format(damping=NOMINAL, actuator=MOTOR)), data


def changes_of(*dampings, episodes=5):
    """What is said of them."""
    spec, data = recordings(*dampings, episodes=episodes)
    return diagnose(spec, data, candidates=["joint_damping"], threads=1).result.changes


def test_a_damping_that_rises_between_episodes_is_found_with_its_values():
    found = changes_of(0.05, 0.08).found
    assert [(f.effect, f.target, f.parameter, f.kind) for f in found] == [
        ("joint_damping", "shoulder", "damping", "step_over")
    ]
    assert (found[0].first, found[0].last) == pytest.approx((0.05, 0.08), rel=0.1) and found[0].p < 0.05
    assert found[0].episode == 5
    values, halves = np.array(found[0].series)[:, 1:].T
    assert values[:5] == pytest.approx(0.05, abs=0.005) and values[5:] == pytest.approx(0.08, abs=0.005)
    assert halves.max() < 0.01, "intervals are of what is around the change, not of the change"


def test_a_damping_that_grows_fivefold_has_its_ends_and_its_share_by_simulation():
    (found,) = changes_of(*np.linspace(0.04, 0.2, 8), episodes=1).found
    assert found.kind == "drift_over" and (found.first, found.last) == pytest.approx((0.04, 0.2), rel=0.05)
    assert found.removed_share > 0.95


def test_where_nothing_changes_nothing_is_found():
    constant = changes_of(0.06, 0.06)
    assert not constant.found and constant.tested > 0


@pytest.mark.parametrize("k", [0, 1, 2])
def test_with_one_free_all_that_is_told_of_parameters_is_of_that_one(k):
    pairs = ((0.0, 5.0), (0.0, 6.0), (0.01, 2.0))
    c = Candidate(
        JointStribeck, "elbow", ("coulomb", "static", "speed"), (0.0, 0.0, 0.1), (0.1, 0.2, 0.3),
        starts=((0.1, 0.1, 0.1),), span=pairs, strength=2, plausible=pairs,
    )  # fmt: skip
    x = np.array([1.0, 2.0, 0.5])
    one = c.with_one_free(k, x)
    assert one.size == 1 and [b.tolist() for b in one.bounds()] == [[pairs[k][0]], [pairs[k][1]]]
    assert one.effect([x[k]]) == c.effect(x)


def test_a_parameter_that_does_nothing_is_constant():
    rng, n = np.random.default_rng(0), 40
    at = WindowTimes(np.repeat(np.arange(8), 5), np.tile(np.arange(5) * 0.1, 8), np.arange(n))
    z, clusters = rng.normal(size=(n, 6)), np.repeat(np.arange(8), 5)
    shapes = [s for s in time_shapes(at) if np.ptp(s.f) > 0]
    _, (p, _) = constancy_test(
        [scores_of(z, [], np.zeros_like(z)), scores_of(z, [], rng.normal(size=z.shape))],
        shapes, clusters, 0,
    )  # fmt: skip
    assert p > 0.5


def test_a_constant_that_stood_in_for_what_changes_goes_again():
    names = ["joint_damping", "joint_drag"]
    context, state = begin_search(*recordings(0.05, 0.3), candidates=names, threads=1)
    (drag,) = [c for c in context.candidates if c.label == "joint_drag(shoulder)"]
    wrong = replace(state, accepted=(AcceptedEffect(0, drag, np.array(drag.nominal)),))
    report, left = find_changes(context, refit_accepted(context, wrong))
    assert [(f.effect, f.kind) for f in report.found] == [("joint_damping", "step_over")]
    assert not left.accepted and report.tested == 3


def test_what_is_left_beside_a_rival_is_measured_anew(monkeypatch):
    names = ["joint_damping", "joint_drag", "joint_armature"]
    context, state = begin_search(*recordings(0.05, 0.3), candidates=names, threads=1)
    of = {c.kind.name: c for c in context.candidates}

    def stale(name, interval=None):
        return AcceptedEffect(0, of[name], np.array(of[name].nominal), interval)

    rival_change = changes.rival_change

    def with_another(*args):
        tested, rival, rest = rival_change(*args)
        return tested, rival, replace(rest, accepted=(*rest.accepted, stale("joint_armature", np.array([[7.0, 8.0]]))))

    monkeypatch.setattr(changes, "rival_change", with_another)
    _, left = find_changes(context, refit_accepted(context, replace(state, accepted=(stale("joint_drag"),))))
    (other,) = left.accepted
    assert other.interval[0, 0] <= other.x[0] <= other.interval[0, 1] < 1
