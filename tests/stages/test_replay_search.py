"""Effects named by replays from known starts, where states tell no positions."""

from dataclasses import replace

import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorBias, ActuatorRotation
from idapt_pl.effects.candidate import Candidate
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.smoothing import ReadRecording
from idapt_pl.stages.replay_search import (
    Replays,
    known_components,
    of_one_length,
    played_in_source,
    search_by_replays,
    signed_screening,
)
from idapt_pl.tasks import make_task

STEPS, RECORDINGS = 15, 8
CANDIDATES = [
    Candidate(ActuatorRotation, "x y", ("angle",), (0.0,), (0.3,), starts=((1.57,),)),
    Candidate(ActuatorBias, "x", ("bias",), (0.0,), (0.05,)),
    Candidate(ActuatorBias, "z", ("bias",), (0.0,), (0.05,)),
]
HAND = [0, 1, 2]


@pytest.fixture(scope="module")
def fetch():
    return make_task("fetch_reach")


def read_of(task, effects, seed, known=None):
    """Replays whose readings are those of a source with effects: scaled, and with noise."""
    rng = np.random.default_rng(seed)
    held = rng.uniform(-1, 1, (RECORDINGS, 1, 4)) + 0.3 * rng.normal(size=(RECORDINGS, STEPS, 4))
    nothing = np.zeros((STEPS + 1, 16))
    recordings = [ReadRecording(nothing, a) for a in held.clip(-1, 1)]
    domain = task.domain("source")
    moved = Replays(task, domain.with_effects(*effects), recordings, HAND, np.ones(3)).simulated()[1]
    start = np.array([1.342, 0.749, 0.535])
    states = np.concatenate([np.broadcast_to(start, (RECORDINGS, 1, 3)), moved], 1)
    wrong = 0.9 * (states - start) + start + 0.004 * rng.normal(size=states.shape) + [0.01, 0.0, -0.02]
    seen = [np.concatenate([w, nothing[:, 3:]], 1) for w in wrong]
    read = [ReadRecording(w, r.actions) for w, r in zip(seen, recordings, strict=True)]
    return Replays(task, domain, read, HAND, moved.std((0, 1)))


@pytest.mark.slow
def test_turned_and_biased_commands_are_named_with_their_values(fetch):
    hidden = [ActuatorRotation("x y", 0.6), ActuatorBias("z", -0.4)]
    found = search_by_replays(CANDIDATES, read_of(fetch, hidden, 0), read_of(fetch, [], 1), 3, SideBySide(2))
    assert found.accepted
    named = {(e.name, e.target): e for e in found.best[0]}
    assert set(named) == {("actuator_rotation", "x y"), ("actuator_bias", "z")}
    assert named["actuator_rotation", "x y"].angle == pytest.approx(0.6, rel=0.15)
    assert named["actuator_bias", "z"].bias == pytest.approx(-0.4, rel=0.25)
    assert found.after < 0.6 * found.before
    tried = [t["candidate"] for t in found.to_dict()["tried"]]
    assert set(tried[:2]) == {"actuator_rotation(x y)", "actuator_bias(z)"}


def test_where_nothing_is_missing_nothing_is_added(fetch):
    found = search_by_replays(CANDIDATES, read_of(fetch, [], 2), read_of(fetch, [], 3), 3, SideBySide(2))
    assert not found.accepted and found.to_dict()["effects"] == []


def test_candidates_are_screened_alike_whatever_the_number_of_threads(fetch):
    read = read_of(fetch, [ActuatorBias("z", -0.4)], 5)
    alone, beside = (signed_screening(CANDIDATES, [], read, SideBySide(n)) for n in (1, 3))
    assert [(c.label, x, e) for c, x, e in alone] == [(c.label, x, e) for c, x, e in beside]
    assert alone[0][0].target == "z" and alone[0][1] < 0
    errors = {c.target: error for c, _, error in alone}
    assert errors["z"] == min(errors.values()) < np.exp(read([]).mean())


def test_screening_takes_some_recordings_from_beginning_to_end(fetch):
    read = replace(read_of(fetch, [], 4), recordings=list(range(40)))
    assert read.few().recordings == list(range(0, 40, 3)) and replace(read, recordings=[1, 2]).few().recordings == [
        1,
        2,
    ]


def test_what_is_known_where_episodes_begin_is_what_hardly_varies_there():
    rng = np.random.default_rng(0)
    starts = np.stack([np.full(20, 1.3), rng.uniform(size=20), np.zeros(20)], 1)  # hand, goal, what never changes
    states = np.stack([rng.normal(1.3, 0.1, 500), rng.uniform(size=500), np.zeros(500)], 1)
    shown, spread = known_components(starts, states)
    assert shown == [0] and spread == pytest.approx([states[:, 0].std()])


def test_recordings_are_of_one_length_and_short_ones_are_left_out():
    lengths = (50, 50, 3, 60)
    made = of_one_length([ReadRecording(np.zeros((n + 1, 2)), np.zeros((n, 1))) for n in lengths])
    assert [len(r) for r in made] == [40, 40, 40]


def test_the_source_plays_recorded_actions_from_where_episodes_begin(fetch):
    recordings = read_of(fetch, [], 4).recordings
    played = played_in_source(fetch, fetch.domain("source"), recordings)
    assert len(played) == RECORDINGS and all(len(p.qpos) == STEPS + 1 == len(p.time) for p in played)
    np.testing.assert_array_equal(played[0].qpos[0], played[1].qpos[0])
    assert not np.array_equal(played[0].qpos[-1], played[1].qpos[-1])
