"""The search finds safe motions, the same ones for the same seed, or says why there are none."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arms import CENTRE, DAMPING, FORCE, FRICTION, OFFSET, RAIL, SERVO, compiled, left_open, quick_plan

from idapt_pl.diagnosis.answer.explanation import ExplainingEffect
from idapt_pl.effects.bodies import BodyCom
from idapt_pl.excitation.design import Goal
from idapt_pl.excitation.limits import ImpossibleMotion, limits_of
from idapt_pl.excitation.plan import design_motion, holding_commands, read_base, start_pose
from idapt_pl.excitation.report import information_rows
from idapt_pl.excitation.wording import (
    inseparable_groups,
    motion_headline,
    motion_in_words,
    pair_in_words,
    plays_needed,
)


def designed(*explanations, xml=SERVO, **settings):
    return design_motion(left_open(*explanations, xml=xml), quick_plan(xml, **settings), threads=1)


@pytest.fixture(scope="module")
def friction():
    return designed(DAMPING, FRICTION, limits=limits_of(compiled(), velocity={"*": (0, 3.0)}))


def test_a_motion_tells_damping_from_friction_and_keeps_its_limits(friction):
    design, rivals, _ = friction
    assert design.separations[0] > 10 and design.reachable[0] >= design.separations[0]
    assert all(m.room >= 0 for m in design.margins)
    assert {m.what for m in design.margins} == {"position shoulder", "velocity shoulder", "contacts"}
    for seen in design.forecasts:
        assert np.abs(seen.qvel).max() < 3.0 and seen.qpos.max() < 0.75  # the wall
    assert "It tells viscous friction" in motion_in_words(design, rivals, Goal.SEPARATE)[0]
    assert motion_headline(design, Goal.SEPARATE) == "A motion that tells all explanations apart"
    assert 0 < design.safe <= design.tried and len(design.commands) == 150


def test_the_same_seed_finds_the_same_motion(friction):
    again = designed(DAMPING, FRICTION, limits=limits_of(compiled(), velocity={"*": (0, 3.0)}))[0]
    assert np.array_equal(again.commands, friction[0].commands)


def test_twins_are_said_to_be_inseparable():
    design, rivals, _ = designed(OFFSET, FORCE, xml=RAIL)
    assert design.reachable[0] < 1
    assert motion_in_words(design, rivals, Goal.SEPARATE)[0].startswith("No safe motion found tells offset")
    assert inseparable_groups(design, rivals) == [[r.name for r in rivals]]
    assert motion_headline(design, Goal.SEPARATE).startswith("No safe motion")


def test_what_is_told_apart_just_so_is_played_more_often_and_most_where_half_of_the_plays_count():
    one, same = (SimpleNamespace(name=n, candidates=[SimpleNamespace(size=1)]) for n in "ab")
    larger = SimpleNamespace(name="c", candidates=[SimpleNamespace(size=3)])
    assert [plays_needed(one, same, d) for d in (3.0, 4.0, 5.0, 40.0)] == [5, 3, 2, 2]
    assert [plays_needed(one, larger, d) for d in (3.0, 4.0, 5.0, 40.0)] == [10, 6, 4, 2]
    assert pair_in_words(one, same, 3.0, 3.0).endswith("just so (3 standard deviations): play it 5 times.")
    assert pair_in_words(one, same, 40.0, 40.0) == "It tells a from b: 40 standard deviations apart."


def test_only_those_are_a_group_of_which_no_two_are_told_apart():
    names = [SimpleNamespace(name=n) for n in "abcd"]
    apart = dict(ab=1.0, ac=9.0, ad=9.0, bc=1.0, bd=9.0, cd=9.0)
    reachable = lambda **changed: SimpleNamespace(reachable=np.array(list((apart | changed).values())))  # noqa: E731
    assert inseparable_groups(reachable(), names) == [["a", "b"], ["b", "c"]]
    assert inseparable_groups(reachable(ac=1.0), names) == [["a", "b", "c"]]
    assert inseparable_groups(reachable(ab=9.0, bc=9.0), names) == []


def test_estimates_get_narrower_with_the_room_there_is():
    wide, _, _ = designed(DAMPING, goal=Goal.ESTIMATE)
    narrow, _, _ = designed(DAMPING, goal=Goal.ESTIMATE, limits=limits_of(compiled(), {"*": (-0.1, 0.1)}))
    each, _, _ = designed(DAMPING, goal=Goal.ESTIMATE_EACH)
    assert wide.deviations[0] < 0.5 * narrow.deviations[0]
    assert each.deviations == pytest.approx(wide.deviations, rel=0.2)  # with one parameter they are the same


@pytest.mark.parametrize("goal", [Goal.ESTIMATE, Goal.ESTIMATE_EACH])
def test_a_parameter_that_no_motion_shows_is_unknown_and_does_not_hide_the_others(goal):
    both, rivals, forecaster = designed(CENTRE, goal=goal)
    alone, _, _ = designed(
        replace(CENTRE, effects=(ExplainingEffect(BodyCom("arm", 0, 0.01, 0.02), {"z": (0, 0.1)}),)), goal=goal
    )
    assert both.deviations[0] == np.inf and both.deviations[1] == pytest.approx(alone.deviations[0], rel=0.3)
    y, z = information_rows(both, rivals[0], {}, forecaster.model)
    assert y["half_width_from_motion"] is None and z["half_width_from_motion"] > 0
    assert motion_in_words(both, rivals, goal)[1] == "This motion tells nothing of centre of mass of body arm: y."


def test_one_explanation_cannot_be_told_apart():
    with pytest.raises(ImpossibleMotion, match="one explanation alone"):
        designed(DAMPING)


def test_a_start_in_a_forbidden_place_allows_no_motion():
    with pytest.raises(ImpossibleMotion, match=r"limits allow no motion.*height reaches"):
        designed(DAMPING, FRICTION, limits=limits_of(compiled(), lowest=0.6))


def test_a_motion_that_is_too_short_is_refused():
    with pytest.raises(ImpossibleMotion, match="too short"):
        designed(DAMPING, FRICTION, duration=0.2)


def test_a_servo_is_held_at_the_first_keyframe():
    keyed = compiled(SERVO.replace("</mujoco>", '<keyframe><key qpos="0.4"/></keyframe></mujoco>'))
    assert start_pose(keyed) == pytest.approx([0.4]) and holding_commands(keyed, start_pose(keyed)) == [0.4]
    offside = compiled(SERVO.replace('range="-2 2"', 'range="0.3 2"'))
    assert start_pose(offside) == pytest.approx([0.3])


HELD = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body><joint name="yaw" axis="0 0 1" damping="1" armature="0.1"/><geom size="0.1" pos="0.3 0 0" mass="1"/>
    <body pos="0.4 0 0"><joint name="lift" type="slide" axis="0 0 1" damping="5"/>
      <geom size="0.05" mass="2"/></body></body></worldbody>
  <actuator><position name="servo" joint="yaw" gear="40" kp="0.05" kv="0.005"/>
    <motor name="hoist" joint="lift" gear="4"/></actuator>
</mujoco>"""


def test_geared_servos_are_held_through_their_gear_and_motors_against_the_weight():
    model = compiled(HELD)
    held = holding_commands(model, np.array([0.5, 0.2]))
    assert held == pytest.approx([20.0, 2 * 9.81 / 4])
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = [0.5, 0.2], held
    mujoco.mj_step(model, data, 1000)
    assert data.qpos == pytest.approx([0.5, 0.2], abs=1e-3), "it stays where it is"
    hanging = compiled(HELD.replace('axis="0 0 1" damping="5"', 'axis="1 0 0" damping="5"'))
    assert holding_commands(hanging, np.zeros(2))[1] == pytest.approx(0), "nothing weighs on it"


@pytest.mark.parametrize(("start", "words"), [([np.nan], "expected 1 finite numbers"), ([3.0], "its range is -2 to 2")])
def test_a_start_that_cannot_be_is_refused(start, words):
    with pytest.raises(ImpossibleMotion, match=words):
        designed(DAMPING, FRICTION, start=np.array(start))


def test_the_start_that_is_told_is_where_the_model_rests():
    """Under its weight the rod sinks from the pose that was asked for, and that is where it begins."""
    _, rivals, forecaster = designed(DAMPING, FRICTION, start=np.array([0.3]), duration=3.0)
    assert forecaster.given == [0.3] and 0.305 < forecaster.rest[0] < 0.33
    assert forecaster.rest == forecaster.start(rivals[0].effects)


def test_recorded_commands_are_the_base_of_a_motion(tmp_path):
    time = np.arange(100) * 0.03
    (tmp_path / "base.csv").write_text("time [s],servo [rad]\n" + "".join(f"{t},{0.2 * np.sin(2 * t)}\n" for t in time))
    base = read_base(tmp_path / "base.csv", compiled(), 0.02)
    held = time[np.searchsorted(time, 0.02 * np.arange(148) + 1e-9, "right") - 1]
    assert base[:, 0] == pytest.approx(0.2 * np.sin(2 * held))
    design, _, _ = designed(DAMPING, FRICTION, base=base)
    assert len(design.commands) == 148 and design.commands[0] == pytest.approx(base[0])


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "expected a head"), ("time,other\n0,1\n1,2\n", "no column 'servo'"), ("time,servo\n0,1\n0,2\n", "increases"),
     ("time,servo\n0,a\n", "expected a head")],
)  # fmt: skip
def test_what_is_no_table_of_commands_is_refused(tmp_path, text, said):
    (tmp_path / "base.csv").write_text(text)
    with pytest.raises(ImpossibleMotion, match=said):
        read_base(tmp_path / "base.csv", compiled(), 0.02)
    with pytest.raises(ImpossibleMotion, match="no such file"):
        read_base(tmp_path / "none.csv", compiled(), 0.02)
