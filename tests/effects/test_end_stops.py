"""Effects on where a joint ends: what they write, and that the joint ends there."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.end_stops import OPEN, JointRange
from idapt_pl.effects.wording import format_estimate

XML = """<mujoco>{}<worldbody><body><joint name="j" axis="0 1 0" damping="0.05" {}/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
</mujoco>"""
RADIANS = '<compiler angle="radian"/>'


def with_range(effect, compiler=RADIANS, own='range="-1 2"'):
    spec = mujoco.MjSpec.from_string(XML.format(compiler, own))
    effect.apply(spec)
    return spec.compile()


def test_the_end_that_is_not_given_stays():
    assert with_range(JointRange("j", upper=0.5)).jnt_range[0].tolist() == [-1, 0.5]
    assert with_range(JointRange("j", lower=0.5)).jnt_range[0].tolist() == [0.5, 2]
    assert with_range(JointRange("*", 0.1, 0.2)).jnt_range[0].tolist() == [0.1, 0.2]


def test_a_joint_without_ends_gets_one():
    model = with_range(JointRange("j", upper=0.5), own="")
    assert model.jnt_limited[0] and model.jnt_range[0].tolist() == [-OPEN, 0.5]
    off = with_range(JointRange("j", upper=0.5), own='range="-1 2" limited="false"')
    assert off.jnt_limited[0] and off.jnt_range[0].tolist() == [-OPEN, 0.5]


def test_ends_are_in_radians_whatever_the_model_writes():
    model = with_range(JointRange("j", upper=0.5), compiler="", own='range="-60 90"')
    assert model.jnt_range[0] == pytest.approx([-np.pi / 3, 0.5])


def test_a_joint_comes_to_rest_at_its_end():
    model = with_range(JointRange("j", upper=0.5))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    assert data.qpos[0] == pytest.approx(0.5, abs=0.02)  # it would hang at pi / 2


def test_ends_that_leave_no_room_are_refused():
    with pytest.raises(ValueError, match=r"joint_range on 'j': from -1 to -1.5 is no range: lower must be below upper"):
        with_range(JointRange("j", upper=-1.5))


def test_where_the_model_has_no_end_nothing_is_compared_with_it():
    one = np.ones(1)
    sizes = TypicalSizes(0.02, one, one, one, 2 * one, one, one, 0.2, stops=np.array([[-0.5, np.nan]]))
    for own, in_model in (("", (None,)), ('range="-1 2"', (-1.0,))):
        (found,) = JointRange.candidates(mujoco.MjSpec.from_string(XML.format(RADIANS, own)).compile(), sizes)
        assert found.names == ("lower",) and found.in_model == in_model
        assert found.nominal[0] < -0.5 and min(found.starts) == (-0.5,), "from outside to where it was seen"


def test_a_search_keeps_to_ends_that_leave_room():
    one = np.ones(1)
    sizes = TypicalSizes(0.02, one, one, one, 2 * one, one, one, 0.2, stops=np.array([[-0.5, 1.5]]))
    model = mujoco.MjSpec.from_string(XML.format(RADIANS, 'range="-1 2"')).compile()
    lower, upper = JointRange.candidates(model, sizes)
    assert lower.bounds()[1] == pytest.approx(0.48) and upper.bounds()[0] == pytest.approx(0.52), "not quite halfway"
    assert with_range(lower.effect([9.0])).jnt_range[0] == pytest.approx([0.48, 2.0])
    narrow = mujoco.MjSpec.from_string(XML.format(RADIANS, 'range="-0.1 0.2"')).compile()
    lower, upper = JointRange.candidates(narrow, sizes)
    assert lower.bounds()[1] == pytest.approx(0.18) and upper.bounds()[0] == pytest.approx(0.2)
    assert with_range(lower.effect([9.0]), own='range="-0.1 0.2"').jnt_range[0] == pytest.approx([0.18, 0.2])


def test_an_interval_that_is_open_on_one_side_is_told_by_its_near_end():
    assert format_estimate(-0.98765, (-13, -0.98765)) == ("-0.988", "-13 to -0.988")
