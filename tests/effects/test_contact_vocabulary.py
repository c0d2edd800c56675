"""Contacts: three kinds of friction, softness and bounce; of a geom, of all, of two that touch."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.contacts import ContactFriction, ContactSoftness, time_and_damping

WORLD = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 1" friction="0.6 0.005 0.0001" condim="{condim}" solref="0.02 1"/>
    <body name="ball" pos="0 0 {height}"><freejoint/>
      <geom name="ball" size="0.1" mass="1" friction="0.6 0.005 0.0001" condim="{condim}"/></body>
    <body name="other" pos="1 0 0.1"><freejoint/><geom name="other" size="0.1" mass="1"/></body>
  </worldbody>{pairs}
</mujoco>"""
PAIRS = '<contact><pair geom1="ball" geom2="floor" friction="0.5 0.5 0.01 0.001 0.001" condim="6"/></contact>'


def spec(condim=3, pairs="", height=0.5):
    return mujoco.MjSpec.from_string(WORLD.format(condim=condim, pairs=pairs, height=height))


def compiled(effect, **settings):
    edited = spec(**settings)
    effect.apply(edited)
    return edited.compile()


def typical(model):
    ones = np.ones(model.nv)
    return TypicalSizes(0.01, ones, ones, ones, ones, np.zeros(0), np.zeros(0), 0.1)


def test_each_coefficient_is_set_alone():
    before = spec().compile().geom("ball").friction
    for k, name in enumerate(("sliding", "torsional", "rolling")):
        after = compiled(ContactFriction("ball", **{name: 0.3})).geom("ball").friction
        assert after[k] == 0.3 and np.delete(after, k).tolist() == np.delete(before, k).tolist()


def test_two_geoms_that_touch_become_a_pair_and_nothing_else_changes():
    model = compiled(ContactFriction("ball floor", sliding=0.2))
    assert model.npair == 1 and model.pair_friction[0].tolist() == [0.2, 0.2, 0.005, 0.0001, 0.0001]
    np.testing.assert_allclose(model.geom_friction, spec().compile().geom_friction)
    np.testing.assert_allclose(model.pair_solref[0], [0.02, 1])


def test_a_listed_pair_is_edited():
    model = compiled(ContactFriction("floor ball", rolling=0.02), pairs=PAIRS)
    assert model.npair == 1 and model.pair_friction[0].tolist() == [0.5, 0.5, 0.01, 0.02, 0.02]


def test_a_damping_ratio_below_one_makes_things_bounce():
    heights = []
    for ratio in (1.0, 0.1):
        model = compiled(ContactSoftness("*", damping_ratio=ratio))
        data = mujoco.MjData(model)
        rebound = []
        while data.time < 0.8:
            mujoco.mj_step(model, data)
            rebound.append(data.qpos[2] if data.time > 0.4 else 0.0)
        heights.append(max(rebound))
    assert heights[0] < 0.15 < heights[1]


def test_softness_leaves_what_it_does_not_name():
    assert compiled(ContactSoftness("ball", damping_ratio=0.3)).geom("ball").solref.tolist() == [0.02, 0.3]
    assert compiled(ContactSoftness("ball", time_constant=0.1)).geom("ball").solref.tolist() == [0.1, 1.0]


def test_stiffness_and_damping_are_the_same_law_in_other_words():
    """Without impedance in between: k = 1 / (T ζ)², b = 2 / T."""
    assert time_and_damping(np.array([-2500.0, -100.0])) == pytest.approx((0.02, 1.0))
    assert time_and_damping(np.array([0.05, 0.4])) == (0.05, 0.4)


@pytest.mark.parametrize(("condim", "kinds"), [(3, 1), (4, 2), (6, 3)])
def test_friction_is_looked_for_where_contacts_have_it(condim, kinds):
    model = spec(condim).compile()
    names = {c.names[0] for c in ContactFriction.candidates(model, typical(model))}
    assert names == set(("sliding", "torsional", "rolling")[:kinds])


def test_bounce_and_softness_are_looked_for_together_and_apart():
    model = spec(pairs=PAIRS).compile()
    found = {(c.target, c.names) for c in ContactSoftness.candidates(model, typical(model))}
    both = ("time_constant", "damping_ratio")
    assert {("*", both[:1]), ("*", both[1:]), ("*", both), ("floor ball", both), ("other", both)} <= found


def test_a_name_that_is_no_geom_is_an_error():
    with pytest.raises(ValueError, match="no geom named 'rock'"):
        compiled(ContactFriction("ball rock", sliding=0.3))
