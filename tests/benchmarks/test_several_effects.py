"""Several hidden effects in one world, and which of them its recordings can show."""

from benchmarks.several_effects import draw, matched, seen_answers, unseen

NAMED = [{"effect": "joint_damping", "target": "hinge2", "equivalent": []}]


def test_a_stop_that_no_joint_comes_to_cannot_be_named_and_does_not_count():
    drawn = draw("double_pendulum", 2, 106)
    assert {t.effect for t in drawn.case.truth} == {"joint_range", "joint_damping"}
    away = unseen(drawn.case, 106)
    assert away == ("joint_range(hinge2)",)
    assert matched(seen_answers(drawn, away), NAMED) == (0, 0)
    assert matched(drawn.answers, NAMED) == (1, 0)


def test_effects_that_change_what_is_recorded_all_count():
    drawn = draw("double_pendulum", 2, 107)
    assert unseen(drawn.case, 107) == ()
    assert seen_answers(drawn, ()) == drawn.answers
