"""From how small a change on usual effects would have been seen."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm import ARM, found, record

from idapt_pl.diagnosis.answer.detection_limits import detection_limits
from idapt_pl.diagnosis.answer.result import Verdict
from idapt_pl.diagnosis.search import diagnose

HIDDEN = {
    ("joint_damping", "elbow"): lambda spec, change: spec.joint("elbow").damping.__setitem__(0, 0.02 + change),
    ("body_mass", "lower"): lambda spec, change: setattr(spec.geom("l"), "mass", 0.4 + change),
}


@pytest.fixture(scope="module")
def nothing_hidden():
    return found(record(episodes=8), seed=0, laws=False)[0]


def limits_by_place(diagnosis):
    return {(x.effect, x.target): x for x in diagnosis.result.limits}


def with_hidden(place, change):
    spec = mujoco.MjSpec.from_string(ARM)
    HIDDEN[place](spec, change)
    spec.compile()
    return spec.to_xml()


def test_every_joint_body_and_motor_has_limits_and_all_together_only_a_delay(nothing_hidden):
    limits = limits_by_place(nothing_hidden)
    assert not nothing_hidden.result.effects
    for joint in ("shoulder", "elbow"):
        assert {("joint_damping", joint), ("joint_frictionloss", joint), ("joint_armature", joint)} <= set(limits)
    assert {("body_mass", "lower"), ("actuator_gain", "s"), ("actuator_gain", "e")} <= set(limits)
    assert {effect for effect, target in limits if target == "*"} == {"actuator_delay"}
    assert all(x.change > 0 for x in limits.values())
    assert limits["joint_damping", "elbow"].nominal == 0.02
    assert "detection_limits" in nothing_hidden.report


@pytest.mark.parametrize("place", HIDDEN)
def test_what_is_twice_as_large_is_found_and_what_is_a_quarter_is_not(nothing_hidden, place):
    limit = limits_by_place(nothing_hidden)[place].change
    named = {}
    for times in (0.25, 2.0):
        data = record(with_hidden(place, times * limit), episodes=8)
        named[times] = set(found(data, seed=0, laws=False)[1]) - {("numerics", "world")}
    assert not named[0.25]
    assert place in named[2.0]


def test_noise_of_three_times_the_size_hides_changes_of_about_three_times_the_size(nothing_hidden):
    loud = found(record(episodes=8, noise=(3e-3, 3e-2)), seed=0, laws=False)[0]
    quiet, loud = limits_by_place(nothing_hidden), limits_by_place(loud)
    ratios = [loud[k].change / quiet[k].change for k in quiet if k in loud]
    assert 2.0 < np.median(ratios) < 4.5


def test_recordings_of_what_hardly_moves_have_no_limits():
    still = record(episodes=8, size=0.0)
    still = dataclasses.replace(still, episodes=tuple(at_rest(e) for e in still.episodes))
    d = diagnose(mujoco.MjSpec.from_string(ARM), still, seed=0, laws=False)
    assert d.verdict is Verdict.INSUFFICIENT_EXCITATION
    assert not d.result.limits and "detection_limits" not in d.report


def at_rest(e):
    rng = np.random.default_rng(len(e.actions))
    seen = {k: s * rng.normal(size=e.observations[k].shape) for k, s in (("qpos", 1e-3), ("qvel", 1e-2))}
    return dataclasses.replace(e, observations=seen)


def test_what_was_found_has_no_limit():
    d = found(record(with_hidden(("joint_damping", "elbow"), 0.1), episodes=8), seed=0, laws=False)[0]
    assert ("joint_damping", "elbow") in {e.key for e in d.result.effects}
    assert ("joint_damping", "elbow") not in limits_by_place(d)
    assert detection_limits(d.context, d.state) == d.result.limits, "computed once more they are the same"
