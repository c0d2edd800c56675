"""Stretches in which a model cannot hold: found where one is planted, none where none is, and left out."""

import sys

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from datamodules import Episode, Trajectories
from idapt_pl.deployment_faults.forecast import choose_starts
from idapt_pl.prediction.data import UnusableData, as_recordings, sample_windows, window_starts
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.stretches.diagnose import diagnose_stretches
from idapt_pl.stretches.find import find_stretches, without_short_gaps
from idapt_pl.stretches.stretch import Stretch, leave_out, marked_steps

sys.path.insert(0, str(ROOT / "benchmarks"))
from benchmarks.stretches import MODELS, record


def simulator(name, data):
    spec = mujoco.MjSpec.from_string(MODELS[name])
    recordings, velocities = as_recordings(spec.copy().compile(), data)
    return Simulator(spec, recordings, velocities, 1)


@pytest.mark.parametrize(
    ("name", "event"), [("pendulum", "push"), ("pendulum", "catch_every"), ("arm", "motors_off"), ("arm", "brake")]
)
def test_planted_stretches_are_found_with_their_times(name, event):
    data, planted = record(name, event, "none", 0)
    found, errors = find_stretches(simulator(name, data), ())
    assert [s.episode for s in found] == sorted(p.episode for p in planted)
    for s, p in zip(found, sorted(planted, key=lambda p: p.episode), strict=True):
        assert abs(s.first - p.first) <= 2 and s.error > 6
        assert s.begin == pytest.approx(0.02 * s.first) and s.channels
        overlap = min(s.last, p.last) - max(s.first, p.first)
        assert overlap > 0.7 * (p.last - p.first) and s.last - p.last <= 3
    assert [len(e.time) for e in errors] == [len(e) - 1 for e in data]


@pytest.mark.parametrize("effect", ["none", "frictionloss", "gain", "damping"])
def test_an_effect_is_no_stretch_even_before_it_is_known(effect):
    data, _ = record("arm", "none", effect, 0)
    assert find_stretches(simulator("arm", data), ())[0] == []


def test_where_most_of_the_recording_fails_it_is_the_model():
    data, _ = record("pendulum", "none", "none", 0)
    turned = [Episode(-e.actions if i % 2 else e.actions, e.observations) for i, e in enumerate(data)]
    assert find_stretches(simulator("pendulum", Trajectories(tuple(turned), data.dt)), ())[0] == []


def test_windows_and_forecasts_avoid_what_is_left_out():
    data, _ = record("pendulum", "none", "none", 0)
    marked = leave_out(data, [Stretch(2, 50, 90, 1.0, 1.8), Stretch(2, 120, 200, 2.4, 4.0)])
    assert marked_steps(marked.episodes[2]).sum() == 120 and not marked_steps(marked.episodes[1]).any()
    (windows,) = [sample_windows(simulator("pendulum", marked).data, np.array([2]), 7, 3, 1000, 0)]
    inside = np.stack([windows.start + k for k in range(7)])
    assert len(windows) and not marked_steps(marked.episodes[2])[inside].any()
    assert 90 in windows.start, "they begin anew where the stretch ends"
    starts = choose_starts([200], 4, 1000, 0, [marked_steps(marked.episodes[2])])
    assert len(starts) and not any(marked_steps(marked.episodes[2])[r : r + 4].any() for r in starts.row)


def test_windows_are_as_ever_where_nothing_is_left_out():
    every = window_starts(None, 3, 40, 6)
    np.testing.assert_array_equal(every, np.arange(3, 35, 6))
    np.testing.assert_array_equal(window_starts(np.zeros(40, bool), 3, 40, 6), every)


def test_a_mark_of_another_shape_is_an_error():
    data, _ = record("pendulum", "none", "none", 0)
    e = data.episodes[0]
    wrong = Episode(e.actions, e.observations, infos={"left_out": np.zeros(7, bool)})
    with pytest.raises(UnusableData, match=r"infos/left_out is bool \(7,\), expected one mark"):
        as_recordings(mujoco.MjModel.from_xml_string(MODELS["pendulum"]), Trajectories((wrong,), 0.02))


def test_only_short_gaps_are_closed():
    high = np.array([0, 1, 0, 1, 0, 0, 0, 1, 0], bool)
    assert without_short_gaps(high, 2).astype(int).tolist() == [0, 1, 1, 1, 0, 0, 0, 1, 0]


def test_the_diagnosis_is_repeated_without_what_was_found_and_tells_what_came_out_with_it():
    """What diagnoses is a double that says how much it was given: the search has tests of its own."""
    data, planted = record("pendulum", "push", "none", 0)
    given = []

    class Found:
        def __init__(self, data):
            given.append(sum(int(marked_steps(e).sum()) for e in data))
            self.sim, self.effects = simulator("pendulum", data), ()
            self.result, self.by_forces = type("Result", (), {"effects": ()})(), False
            self.verdict = type("Verdict", (), {"value": "no_missing_effect"})()

    out, report = diagnose_stretches(Found, data)
    assert given[0] == 0 and len(given) == 2 and given[1] == sum(s.last - s.first for s in report.stretches)
    assert sorted(s.episode for s in report.found) == sorted(p.episode for p in planted)
    assert report.to_dict()["verdict_with_them"] == "no_missing_effect" and 0 < report.share < 0.2
    given.clear()
    out, report = diagnose_stretches(Found, data, look=False)
    assert given == [0] and report.stretches == () and out.sim is not None
