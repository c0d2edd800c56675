"""What was taken for what, from cells of tables."""

from benchmarks.confusion import counted, labels, pairs
from benchmarks.several_effects import matched


def test_cells_are_read_without_numerics():
    assert labels("joint_damping(*) damping=0.1 + numerics(world)") == [("joint_damping", "*")]
    assert labels("") == []


def test_the_same_goes_together_before_anything_else():
    a, b, moved, other = ("gain", "x"), ("delay", "y"), ("gain", "z"), ("lag", "y")
    assert pairs([a, b], [b, a]) == [("gain", "gain"), ("delay", "delay")]
    assert pairs([a, b], [moved, other]) == [("gain", "gain elsewhere"), ("delay", "lag")]
    assert pairs([a], [a, b]) == [("gain", "gain"), ("nothing", "delay")]
    assert counted([{"truth": "gain(x)=1", "found": ""}, {"truth": "", "found": ""}]) == {
        ("gain", "nothing"): 1, ("nothing", "nothing"): 1
    }  # fmt: skip


def test_without_what_it_could_also_be_an_effect_counts_by_its_first_name():
    answers = ((frozenset({("gain", "x")}),),)
    listed = {"effect": "lag", "target": "y", "equivalent": [{"effect": "gain", "target": "x"}]}
    assert matched(answers, [listed]) == (0, 0) and matched(answers, [{**listed, "equivalent": []}]) == (1, 1)
