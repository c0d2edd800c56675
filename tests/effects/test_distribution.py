"""Drawn effects lie in their ranges, change the model, and leave what they do not say as it is."""

import mujoco
import numpy as np
import pytest
import yaml
from conftest import CART, ROOT

from idapt_pl.effects import Domain
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.distribution import distribution_from, within_intervals
from idapt_pl.effects.visual import CAMERA, CameraPose, Light
from idapt_pl.randomisation import RandomisationSettings, found_intervals
from idapt_pl.randomisation.settings import RANGES, draw_variants
from idapt_pl.tasks import TASKS, make_task


def domain(*effects):
    return Domain("source", lambda: mujoco.MjSpec.from_string(CART), effects)


def drawn(entries, number=200, base=None, seed=0):
    base, rng = base or domain(), np.random.default_rng(seed)
    distribution = distribution_from(entries)
    return [distribution.sample(base, rng) for _ in range(number)]


def mass(spec):
    return {"effect": "body_mass", "target": "cart", "parameters": {"mass": spec}}


def masses(entries, **kwargs):
    return np.array([d.effects[-1].mass for d in drawn(entries, **kwargs)])


def test_uniform_draws_lie_in_their_range_fill_it_and_reach_the_compiled_model():
    found = drawn(mass({"uniform": [2, 6]}))
    values = np.array([d.effects[0].mass for d in found])
    assert values.min() >= 2 and values.max() <= 6 and values.min() < 2.1 and values.max() > 5.9
    assert abs(values.mean() - 4) < 0.3
    for d in found[:5]:
        assert d.compile().body("cart").mass[0] == pytest.approx(d.effects[0].mass)


def test_log_uniform_draws_are_as_often_below_the_geometric_mean_as_above():
    values = masses(mass({"log_uniform": [0.1, 10]}), number=1000)
    assert values.min() >= 0.1 and values.max() <= 10 and abs((values < 1).mean() - 0.5) < 0.05


def test_a_choice_is_one_of_its_values_and_each_comes():
    assert set(masses(mass({"choice": [1, 2, 5]}))) == {1, 2, 5}


@pytest.mark.parametrize("word", ["uniform", "log_uniform"])
@pytest.mark.parametrize("value", [4.895, 0.1, 1 / 3, 7e-5])
def test_a_range_of_no_width_gives_its_value_to_the_bit(word, value):
    assert set(masses(mass({word: [value, value]}))) == {value}


def test_vectors_are_drawn_component_by_component():
    entry = {
        "effect": "color",
        "target": "box",
        "parameters": {"rgba": {"uniform": [[0, 0.5, 0, 1], [1, 0.5, 0.2, 1]]}},
    }
    values = np.array([d.effects[0].rgba for d in drawn(entry)])
    assert (values[:, [1, 3]] == (0.5, 1)).all() and values[:, 2].max() <= 0.2
    assert abs(np.corrcoef(values[:, 0], values[:, 2])[0, 1]) < 0.3


def test_parameters_that_are_not_drawn_stay_what_the_domain_has():
    base = domain(CameraPose(CAMERA, 90, -45, 2.0, (0, 0, 0), fovy=50), BodyMass("cart", 3.0))
    entry = {"effect": "camera_pose", "target": "view", "parameters": {"azimuth": {"uniform": [80, 85]}}}
    for d in drawn(entry, 5, base):
        camera, body = d.effects
        assert 80 <= camera.azimuth <= 85 and (camera.elevation, camera.distance, camera.fovy) == (-45, 2.0, 50)
        assert body == base.effects[1]


def test_of_two_effects_on_the_same_the_later_one_is_drawn_since_it_counts():
    base = domain(BodyMass("cart", 3.0), BodyMass("cart", 5.0))
    (found,) = drawn(mass(7.0), 1, base)
    assert [e.mass for e in found.effects] == [3.0, 7.0]


def test_several_targets_have_values_of_their_own():
    entry = {
        "effect": "light",
        "target": ["lamp", "headlight"],
        "parameters": {"diffuse": {"uniform": [[0] * 3, [1] * 3]}},
    }
    for d in drawn(entry, 5, domain(Light("lamp", (1, 1, 1)))):
        lamp, head = d.effects
        assert (lamp.target, head.target) == ("lamp", "headlight") and lamp.diffuse != head.diffuse


def test_one_of_several_and_nothing_may_be_among_them():
    entries = {
        "one_of": [[], mass(2.0), [mass(3.0), {"effect": "color", "target": "box", "parameters": {"rgba": [0] * 4}}]]
    }
    assert {len(d.effects) for d in drawn(entries)} == {0, 1, 2}


def test_same_seed_same_worlds():
    entries, base = [mass({"uniform": [1, 2]})], domain()
    first, again, other = (drawn(entries, 5, base, seed) for seed in (3, 3, 4))
    assert first == again != other


@pytest.mark.parametrize(("entries", "says"), [
    ("mass", "is a list of entries"),
    ([{"target": "cart"}], "entry 1: needs effect, target, parameters"),
    ([mass(1), {"effect": "mass"}], "entry 2: unknown effect 'mass'; known effects: "),
    (mass({"uniform": [2, 1]}), "the lower first"),
    (mass({"uniform": [1, 2, 3]}), "takes two ends"),
    (mass({"log_uniform": [0, 1]}), "above zero"),
    (mass({"choice": []}), "choice takes a list"),
    (mass({"normal": [0, 1]}), "uniform, log_uniform, choice"),
    (mass({"uniform": ["a", "b"]}), "uniform"),
    ({"effect": "body_mass", "target": "cart", "parameters": {"weight": 1}}, "parameters must be among ['mass']"),
    (mass(1) | {"when": 1}, "needs effect, target, parameters"),
])  # fmt: skip
def test_what_is_no_distribution_is_told_in_words(entries, says):
    with pytest.raises(ValueError) as error:
        distribution_from(entries)
    assert says in str(error.value)


@pytest.mark.parametrize(("entries", "says"), [
    (mass({"uniform": [-1, 2]}), "is outside"),
    ({"effect": "body_mass", "target": "cat", "parameters": {"mass": 1}}, "no body named 'cat'; it has: "),
    ({"effect": "body_mass", "target": "cart"}, "do not make one, which has mass"),
    ({"one_of": [mass(1), {"effect": "body_mass", "target": "cat", "parameters": {"mass": 1}}]}, "no body named 'cat'"),
    (mass({"choice": [1, 2, -3]}), "is outside"),
])  # fmt: skip
def test_what_does_not_suit_a_model_is_found_without_drawing(entries, says):
    with pytest.raises(ValueError) as error:
        distribution_from(entries).check(domain())
    assert says in str(error.value)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ["narrow", "paper_narrow", "wide"])
def test_the_ranges_of_every_task_suit_it(task, name):
    source = make_task(task, {}).domain("source")
    distribution = RandomisationSettings(name).distribution(task)
    distribution.check(source)
    first, second = draw_variants(distribution, source, 2, seed=0)
    assert first != second and first.compile().nq == source.compile().nq


PHYSICS = {
    "inverted_pendulum": [("body_mass", "mass")], "half_cheetah": [("joint_armature", "armature")],
    "walker2d": [("body_mass", "mass")], "fetch_reach": [("actuator_rotation", "angle"), ("actuator_bias", "bias")],
    "sawyer_push": [("body_mass", "mass")],
}  # fmt: skip
"""What the targets' physics differ in."""


@pytest.mark.parametrize("task", TASKS)
def test_the_papers_wide_ranges_hold_both_targets_and_its_narrow_ones_the_easy_one(task):
    entries, domains = yaml.safe_load((RANGES / f"{task}.yaml").read_text()), make_task(task, {}).domains()
    for effect, parameter in PHYSICS[task]:
        for ranges, names in (("wide", ("source", "easy", "hard")), ("paper_narrow", ("source", "easy"))):
            (entry,) = [e for e in entries[ranges] if e.get("effect") == effect]
            low, high = entry["parameters"][parameter]["uniform"]
            for name in names:
                values = [getattr(e, parameter) for e in domains[name].effects if e.name == effect]
                assert low <= (values[-1] if values else 0.0) <= high, (ranges, name)


def test_narrow_ranges_know_nothing_of_the_hard_targets_physics():
    for task in ("inverted_pendulum", "half_cheetah", "walker2d", "sawyer_push"):
        entries, domains = yaml.safe_load((RANGES / f"{task}.yaml").read_text()), make_task(task, {}).domains()
        (effect, parameter) = PHYSICS[task][0]
        (entry,) = [e for e in entries["narrow"] if e.get("effect") == effect]
        low, high = entry["parameters"][parameter]["log_uniform"]
        value = [getattr(e, parameter) for e in domains["source"].effects if e.name == effect][-1]
        assert (low, high) == pytest.approx((value / 2, 2 * value), rel=0.01)


def test_what_was_found_is_drawn_from_its_interval_and_refined_values_count_more():
    found = [{"effect": "body_mass", "target": "cart", "parameters": {"mass": 8.0}}]
    wide = {"nominal": 1.0, "estimate": 7.0, "ci95": [3.6, 14.7], "unit": "kg"}
    estimates = [{"effect": "body_mass", "target": "cart", "parameters": {"mass": wide}}]
    refined = [
        {"effect": "body_mass", "target": "cart", "parameter": "mass", "before": 7, "after": 8, "log_halfwidth": 0.2}
    ]
    base, rng = domain(BodyMass("cart", 8.0)), np.random.default_rng(0)

    def ends(*told):
        distribution = found_intervals(found, *told)
        values = [distribution.sample(base, rng).effects[-1].mass for _ in range(300)]
        return min(values), max(values)

    assert ends(estimates, []) == pytest.approx((3.6, 14.7), rel=0.05)
    assert ends(estimates, refined) == pytest.approx((8 * np.exp(-0.2), 8 * np.exp(0.2)), rel=0.05)
    assert ends([], []) == (8.0, 8.0), "without an interval it stays as it was found"
    assert within_intervals([]).sample(base, rng) == base


def test_the_page_shows_a_distribution_that_can_be_drawn_from(tmp_path):
    page = (ROOT / "docs/guide/baselines.md").read_text()
    text = page.split("<!-- ranges-example -->\n```yaml\n")[1].split("```")[0]
    (tmp_path / "mine.yaml").write_text(text)
    distribution = RandomisationSettings(str(tmp_path / "mine.yaml")).distribution("half_cheetah")
    distribution.check(make_task("half_cheetah", {}).domain("source"))
