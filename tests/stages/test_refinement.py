"""Parameters of effects are found again from biased readings of episodes whose start is known; others stay."""

import json

import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping
from idapt_pl.envs import VectorStateEnv
from idapt_pl.smoothing import ReadRecording, RecordingSmoother, reading_model
from idapt_pl.stages.known_start_search import (
    MEMBERS_SCREENED,
    RECORDINGS_GLANCED,
    RECORDINGS_TRIED,
    KnownStartSearch,
    gain_of,
    screened,
    search_from_known_starts,
)
from idapt_pl.stages.refinement import (
    READING_ERROR,
    KnownStartForecasts,
    position_components,
    refine_parameters,
    scalars,
    scaled,
)
from idapt_pl.tasks import make_task

TRUE = 12.0
"""Mass of the torso, kg; nominal is 6.36."""


def play(domain, actions):
    """States of six episodes side by side, (T+1, 6, 17)."""
    env = VectorStateEnv(make_task("half_cheetah"), domain, 6)
    states = [env.reset(seed=1)[0]["state"], *(env.step(a)[0]["state"] for a in actions)]
    env.close()
    return np.asarray(states, float)


def forecasts(*missing, seed=0, paired=0, begin=0):
    """Forecasts of what a biased sensor reads of a cheetah with these effects, by one without.

    In the first ``paired`` steps it reads what the one without would do, as after G has learned these as pairs; the
    first ``begin`` are not judged.
    """
    task, rng = make_task("half_cheetah"), np.random.default_rng(seed)
    source = task.domain("source")
    actions = rng.uniform(-1, 1, (25, 6, 6)).astype(np.float32)
    states = play(source.with_effects(*missing), actions)
    states[: paired + 1] = play(source, actions[:paired])
    actions = actions.astype(float)
    spread = states.reshape(-1, 17).std(0)
    read = states + spread * (0.2 * rng.normal(size=17) + 0.1 * rng.normal(size=states.shape))
    rows = states.reshape(-1, 17)
    expected = reading_model(task, source, rows + 0.1 * spread * rng.normal(size=rows.shape), rows).times(READING_ERROR)
    with_starts = RecordingSmoother(task, source, expected, 16, 0, 1, states[0])
    recordings = [ReadRecording(read[:, i], actions[:, i]) for i in range(6)]
    return KnownStartForecasts(with_starts, recordings, begin, 25, range(8), spread[:8], 0)


@pytest.fixture(scope="module")
def errors():
    """Of a cheetah with a heavier torso."""
    return forecasts(BodyMass("torso", TRUE))


CANDIDATES = [
    Candidate(BodyMass, "torso", ("mass",), (6.36,), (3.0,)),
    Candidate(BodyMass, "ffoot", ("mass",), (0.85,), (0.5,)),
    Candidate(JointDamping, "bshin", ("damping",), (4.5,), (4.0,)),
    Candidate(ActuatorGain, "*", ("gain",), (1.0,), (0.3,)),
]
"""The first is right."""


@pytest.fixture(scope="module")
def nothing():
    """Of a cheetah that lacks nothing."""
    return forecasts(seed=5)


@pytest.mark.slow
def test_what_is_missing_is_found_from_known_starts_and_nothing_where_nothing_is(errors, nothing):
    found = search_from_known_starts(CANDIDATES, errors, nothing).to_dict()
    (effect,) = found["effects"]
    assert (effect["effect"], effect["target"]) == ("body_mass", "torso")
    assert abs(np.log(effect["parameters"]["mass"] / TRUE)) < 0.2
    assert found["tried"][0]["candidate"] == "body_mass(torso)" and found["error"]["after"] < found["error"]["before"]
    assert json.loads(json.dumps(found)) == found

    none = search_from_known_starts(CANDIDATES, forecasts(seed=6), nothing).to_dict()
    assert none["effects"] == []


def test_steps_that_G_learned_as_pairs_hide_what_is_missing_and_are_not_judged():
    torso, paired = BodyMass("torso", TRUE), 12
    found = {}
    for begin in (0, paired):
        (now,), _ = refine_parameters([BodyMass("torso", 9.0)], forecasts(torso, paired=paired, begin=begin))
        found[begin] = now.mass
    assert abs(np.log(found[paired] / TRUE)) < 0.2 and found[0] < 0.8 * found[paired]


class Counted:
    """Forecasts of so many recordings, best where a torso weighs what the third of ten candidates says."""

    def __init__(self, recordings, asked, members=16):
        self.recordings, self.asked, self.members = recordings, asked, members

    def first(self, recordings):
        return Counted(recordings, self.asked, self.members)

    def roughly(self, members):
        return Counted(self.recordings, self.asked, members)

    def __call__(self, effects):
        assert self.members == MEMBERS_SCREENED
        self.asked.append((self.recordings, effects[0].target if effects else None))
        number = int(effects[0].target) if effects else 20
        return np.full(self.recordings, 0.1 * abs(number - 3))


def test_all_candidates_are_glanced_at_and_the_best_are_tried_on_more_recordings():
    candidates = [Candidate(BodyMass, str(i), ("mass",), (1.0,), (0.5,)) for i in range(20)]
    asked = []
    found = screened(candidates, Counted(60, asked))
    assert {t for n, t in asked if n == RECORDINGS_GLANCED} == {str(i) for i in range(20)}
    stayed = {t for n, t in asked if n == RECORDINGS_TRIED} - {None}
    assert stayed == {c.target for c, _, _ in found} == {str(i) for i in range(8)} and found[0][0].target == "3"
    assert {n for n, _ in asked} == {RECORDINGS_GLANCED, RECORDINGS_TRIED}


def test_what_all_joints_share_is_tried_on_more_recordings_whatever_a_glance_says():
    candidates = [Candidate(BodyMass, str(i), ("mass",), (1.0,), (0.5,)) for i in range(20)]
    shared, asked = Candidate(JointArmature, "*", ("armature",), (1.0,), (0.5,)), []

    class Misled(Counted):
        def first(self, recordings):
            return Misled(recordings, self.asked, self.members)

        def roughly(self, members):
            return Misled(self.recordings, self.asked, members)

        def __call__(self, effects):
            if effects and effects[0].target == "*":
                self.asked.append((self.recordings, "*"))
                return np.full(self.recordings, 9.0 if self.recordings == RECORDINGS_GLANCED else -1.0)
            return super().__call__(effects)

    found = screened([*candidates, shared], Misled(60, asked))
    assert found[0][0] is shared and (RECORDINGS_GLANCED, "*") in asked


class OfTwoKinds:
    """Forecasts of 60 recordings, by which an effect is chosen, and some others, with what any effect gains in each."""

    def __init__(self, gains):
        self.recordings, self.gains = range(len(gains)), np.asarray(gains, float)

    def first(self, recordings):
        return OfTwoKinds(self.gains[:recordings])

    def beyond(self, recordings):
        return OfTwoKinds(self.gains[recordings:])

    def roughly(self, members):
        return self

    def __call__(self, effects):
        noise = np.random.default_rng(len(self.gains)).normal(0, 1e-3, len(self.gains))
        return -1 - (self.gains + noise if effects else np.zeros(len(noise)))


@pytest.mark.parametrize(
    "gain, others, found",
    [
        (0.2, [0.0] * 60, False),  # it was the best of many by chance
        (0.07, [0.07] * 60, True),  # little, and sure
        (0.07, [0.04] * 60, False),
        (0.07, [0.35, -0.21] * 30, False),  # not sure
        (0.07, [0.07] * 10, False),  # too few to tell, so all that is known is what it was chosen by
        (0.15, [0.07] * 10, True),
    ],
)
def test_an_effect_is_judged_by_recordings_that_it_was_not_chosen_by(gain, others, found):
    of_target = OfTwoKinds([gain] * 60 + others)
    searched = search_from_known_starts(CANDIDATES[:1], of_target, OfTwoKinds([-0.5] * 30))
    assert searched.accepted is found
    judged = others if len(others) > 20 else [gain]
    assert searched.gain[0] == pytest.approx(np.mean(judged), abs=0.01)


@pytest.mark.slow
def test_what_helps_in_the_control_too_makes_up_for_the_sensor(errors):
    assert search_from_known_starts(CANDIDATES, errors, errors).to_dict()["effects"] == []


@pytest.mark.slow
def test_a_gain_of_few_recordings_has_no_error_and_is_not_enough():
    without, misfit = np.array([9.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.1, 0.1, 0.1])
    gain, enough = gain_of([BodyMass("body", 2.0)], without, misfit, lambda effects: np.zeros(4))
    assert gain[0] > 0 and not enough
    written = KnownStartSearch(([], []), False, 1.0, 1.0, gain, ()).to_dict()
    assert written["gain"]["standard_error"] is None
    json.loads(json.dumps(written, allow_nan=False))


@pytest.mark.parametrize("start", [8.5, 16.0])
def test_a_mass_is_found_again(errors, start):
    (found,), (how,) = refine_parameters([BodyMass("torso", start)], errors)
    assert abs(np.log(found.mass / TRUE)) < 0.15 < abs(np.log(start / TRUE))
    assert (how.before, how.after, how.parameter) == (start, found.mass, "mass")
    assert abs(np.log(found.mass / TRUE)) < how.log_halfwidth < 0.5


def test_what_is_right_stays(errors):
    (mass, gain), how = refine_parameters([BodyMass("torso", TRUE), ActuatorGain("*", 1.0)], errors)
    assert mass.mass == pytest.approx(TRUE, rel=0.1) and gain.gain == pytest.approx(1.0, rel=0.1)
    assert [r.effect for r in how] == ["body_mass", "actuator_gain"]


def test_parameters_stay_within_their_bounds():
    effect = BodyMass("torso", TRUE)
    assert scalars([effect]) == [(0, "mass")]
    assert scaled(effect, "mass", 1e30).mass < 1e30 * TRUE
    assert scaled(effect, "mass", 1.5).mass == 18.0


def test_positions_are_told_from_velocities():
    for name, count in (("walker2d", 8), ("half_cheetah", 8), ("inverted_pendulum", 2)):
        task = make_task(name)
        state = np.random.default_rng(0).normal(size=2 * count + (count > 2))
        assert position_components(task, state) == list(range(count))


def test_a_single_recording_gives_no_interval():
    (found,), (how,) = refine_parameters([BodyMass("torso", 9.0)], lambda e: np.array([np.log(e[0].mass / TRUE) ** 2]))
    assert found.mass == pytest.approx(TRUE, rel=1e-3) and how.log_halfwidth is None
