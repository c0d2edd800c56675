"""Conditions on recorded channels: what holds where, and what is refused without ever being run."""

import numpy as np
import pytest

from datamodules import Episode, Trajectories
from idapt_pl.stretches.conditions import BadCondition, idle_conditions, kept_steps, mark_by_conditions, parse_condition
from idapt_pl.stretches.stretch import marked_steps

T, DT = 10, 0.5
EPISODE = Episode(
    np.linspace(0, 9, T, dtype=np.float32)[:, None].repeat(2, 1) * [1, -1],
    {"qpos": np.arange(T + 1.0)[:, None], "force": np.arange(3 * (T + 1.0)).reshape(T + 1, 3)},
    infos={
        "state": np.array([1] * 4 + [2] * 4 + [3] * 2), "estop": np.array([0] * 6 + [1] * 2 + [0] * 3),
        "mode": np.array([b"walk"] * 5 + [b"fall"] * 6), "battery voltage": np.linspace(20, 10, T + 1),
        "odd": np.ones(3),
    },
)  # fmt: skip


def kept(condition, **more):
    return np.flatnonzero(kept_steps(condition, 3, EPISODE, DT, **more)).tolist()


@pytest.mark.parametrize(
    ("condition", "steps"),
    [
        ("state == 2", [4, 5, 6, 7]),  # a row for each action: the step itself
        ("1.0 <= time <= 3", [2, 3, 4, 5]),  # a row for each observation: both ends of the step
        ("estop == 0", [0, 1, 2, 3, 4, 8, 9]),
        ("not estop == 1", [0, 1, 2, 3, 4, 8, 9]),
        ("qpos < 2.5 or qpos > 7", [0, 1, 8, 9]),
        ("force[2] > 20 and state != 3", [7]),
        ("actions[1] < -7.5", [8, 9]),
        ("mode == 'walk'", [0, 1, 2, 3]),
        ("'battery voltage' > 15.5", [0, 1, 2, 3]),
        ("episode == 3", list(range(T))),
        ("episode == 2", []),
        ("-1 < qpos < 1.5", [0]),
    ],
)
def test_steps_that_a_condition_keeps(condition, steps):
    assert kept(condition) == steps


def test_without_leaves_out_every_step_that_the_condition_touches():
    assert kept("estop == 1", holds=False) == [0, 1, 2, 3, 4, 8, 9]


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('ls') == 0", "time", "1 + time > 2", "time if 1 else 2", "(lambda: 1)() == 1",
        "time in [1, 2]", "time is 3", "state ==", "", "a.b == 1", "x[0:2] > 1", "x['a'] > 1", "a := 3", "x[y] > 1",
        "time == 1; time", "(" * 300 + "time" + ")" * 300, "time > " + "9" * 600, "time == None", "f'{time}' == 1",
    ],
)  # fmt: skip
def test_what_is_no_condition_is_refused(text):
    with pytest.raises(BadCondition, match=r"condition .*write for example"):
        parse_condition(text)


@pytest.mark.parametrize(
    ("condition", "said"),
    [
        ("estopp == 1", "has no channel 'estopp'; it has: actions, battery voltage, episode, estop"),
        ("force > 1", "channel 'force' has 3 columns: say which, as in force\\[0\\]"),
        ("force[3] > 1", "has columns 0 to 2, not 3"),
        ("odd == 1", "expected 10 or 11 rows"),
        ("mode == 3", "compares words with numbers"),
        ("time > 'late'", "compares words with numbers"),
    ],
)
def test_what_does_not_fit_the_recording_is_told(condition, said):
    with pytest.raises(BadCondition, match=said):
        kept(condition)


def test_marks_of_both_options_add_up_and_nothing_left_is_an_error():
    data = Trajectories((EPISODE, EPISODE), DT)
    marked = mark_by_conditions(data, ["episode == 1"], ["state == 3"])
    assert [np.flatnonzero(~marked_steps(e)).tolist() for e in marked] == [[], list(range(8))]
    with pytest.raises(BadCondition, match="leave no control step; state is 1, 2, 3"):
        mark_by_conditions(data, ["state == 7"])


def test_conditions_that_leave_nothing_out_are_told():
    data = Trajectories((EPISODE, EPISODE), DT)
    assert idle_conditions(data, ["state > 0", "state == 2"], ["episode == 4", "episode == 1"]) == [
        "--only 'state > 0' leaves nothing out; state is 1, 2, 3",
        "--without 'episode == 4' leaves nothing out; episode is 0, 1",
    ]
