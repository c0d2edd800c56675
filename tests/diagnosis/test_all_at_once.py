"""The usual effects of all joints and motors, tried together where a search one by one is far from the recordings."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.all_at_once import add_all_at_once, usual
from idapt_pl.diagnosis.state.search_state import AcceptedEffect
from idapt_pl.diagnosis.state.settings import SearchSettings

NOMINAL = ARM.replace('damping="0.05"', 'damping="0.02"')
HIDDEN = NOMINAL.replace('damping="0.02"', 'damping="0.02" frictionloss="0.1" armature="0.02"').replace(
    "<motor ", '<motor gear="0.6" '
)


def begun(xml, **settings):
    data = record(xml, noise=(1e-4, 1e-3))
    return begin_search(
        mujoco.MjSpec.from_string(NOMINAL), data, settings=SearchSettings(numerics=False, **settings)
    )  # fmt: skip


@pytest.fixture(scope="module")
def started():
    return begun(HIDDEN)


def test_what_helps_together_is_found_and_what_is_needless_goes(started):
    """No damping is hidden. Rounds, by which effects are told apart, go on from the given one."""
    context, state = started
    found = add_all_at_once(context, state, 3)
    values = {a.candidate.label: float(a.x[0]) for a in found.accepted}
    assert values == pytest.approx(
        {"joint_frictionloss(*)": 0.1, "joint_armature(*)": 0.02, "actuator_gain(*)": 0.6}, rel=0.05
    )
    assert [a.round for a in found.accepted] == [4, 5, 6]


def test_nothing_is_added_to_the_right_model():
    context, state = begun(NOMINAL)
    assert add_all_at_once(context, state, 0) is state


def test_nothing_is_added_that_would_be_more_than_asked_for():
    context, state = begun(HIDDEN, max_effects=2)
    assert add_all_at_once(context, state, 0) is state


def test_what_is_accepted_is_not_tried_again(started):
    context, state = started
    tried = ["joint_damping(*)", "joint_frictionloss(*)", "joint_armature(*)", "actuator_gain(*)"]
    assert [c.label for c in usual(context, state)] == tried
    gain = next(c for c in context.candidates if c.label == "actuator_gain(*)")
    known = replace(state, accepted=(AcceptedEffect(0, gain, np.array([0.6])),))
    assert [c.label for c in usual(context, known)] == tried[:-1]
