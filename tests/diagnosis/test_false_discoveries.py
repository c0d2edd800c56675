"""How probable single effects are, and what a false discovery rate leaves of a diagnosis."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import ARM, found, record

from cli.main import main
from datamodules import write_trajectories
from idapt_pl.diagnosis.answer.changes import ChangeFinding, ChangeReport
from idapt_pl.diagnosis.answer.explanation import ExplainingEffect, Explanation, Standing
from idapt_pl.diagnosis.answer.false_discoveries import effect_probabilities, nameable
from idapt_pl.diagnosis.answer.law_result import LawFinding, LawReport, NetworkFinding
from idapt_pl.diagnosis.answer.result import Verdict
from idapt_pl.diagnosis.claims import claim, without_changes_of, without_laws_on
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.effects.learned import LearnedForce, ResidualNetwork

DAMPING, FRICTION = JointDamping("shoulder", 0.2), JointFrictionloss("shoulder", 0.2)
ARMATURE, LAW = JointArmature("elbow", 0.01), LearnedForce("elbow", "-a * v", 0.1)


def explained(probability, *effects, standing=Standing.EQUIVALENT):
    return Explanation(standing, "", tuple(ExplainingEffect(e, {}) for e in effects), 1.0, probability)


def test_an_effect_is_as_probable_as_the_explanations_that_have_it():
    told = [explained(0.6, DAMPING, ARMATURE, standing=Standing.FOUND), explained(0.4, FRICTION, ARMATURE)]
    assert effect_probabilities(told) == {("joint_damping", "shoulder"): 0.6, ("joint_armature", "elbow"): 1.0}


def test_an_effect_is_more_probable_than_that_nothing_else_is_missing():
    (alone,) = effect_probabilities([explained(0.1, DAMPING, standing=Standing.FOUND)]).values()
    (sure,) = effect_probabilities([explained(0.9, DAMPING, standing=Standing.FOUND)]).values()
    assert 0.1 < alone < sure < 1.0


def test_a_law_is_less_probable_than_a_known_effect():
    probable = effect_probabilities([explained(0.9, DAMPING, LAW, standing=Standing.FOUND)])
    assert probable["learned_force", "elbow"] < probable["joint_damping", "shoulder"]


def test_where_something_else_is_surely_missing_what_was_found_has_no_probability():
    told = [explained(0.0, DAMPING, standing=Standing.FOUND), explained(0.0, FRICTION)]
    assert effect_probabilities(told) == {("joint_damping", "shoulder"): 0.0}


def test_nothing_found_is_nothing_probable():
    assert effect_probabilities([]) == {}


@pytest.mark.parametrize(
    ("rate", "named"), [(0.01, set()), (0.02, {"a"}), (0.06, {"a", "b"}), (0.1, {"a", "b"}), (0.5, {"a", "b", "c"})]
)
def test_as_many_are_named_as_the_rate_bears(rate, named):
    """Doubts of 0.02, 0.1, 0.6: 0.02, 0.06 and 0.24 of one, two and three are expected to be false."""
    probable = {("effect", name): p for name, p in (("a", 0.98), ("c", 0.4), ("b", 0.9))}
    assert {target for _, target in nameable(probable, rate)} == named


def test_expected_false_discoveries_stay_below_the_rate():
    """A law: whatever the probabilities, effects that are there as often as said are false in at most the rate."""
    rng = np.random.default_rng(0)
    for rate in (0.05, 0.2):
        false = named = 0
        for _ in range(400):
            probable = {("e", str(i)): float(p) for i, p in enumerate(rng.beta(4, 1, size=6))}
            chosen = nameable(probable, rate)
            named += len(chosen)
            false += sum(rng.random() > probable[key] for key in chosen)
        assert named > 100 and false / named < rate + 0.03


@pytest.fixture(scope="module")
def two_found():
    """A diagnosis of an arm with more damping in the shoulder and a rotor in the elbow."""
    hidden = ARM.replace('damping="0.05"', 'damping="0.25"').replace('damping="0.02"', 'damping="0.02" armature="0.02"')
    diagnosis, effects = found(record(hidden), threads=1)
    assert set(effects) == {("joint_damping", "shoulder"), ("joint_armature", "elbow")}
    return diagnosis


def doubting(diagnosis, **probable):
    """The diagnosis with other probabilities of its effects, by their targets."""
    effects = [replace(e, probability=probable[e.target]) for e in diagnosis.result.effects]
    return replace(diagnosis, result=replace(diagnosis.result, effects=effects))


def test_what_is_sure_enough_stays_as_it_was(two_found):
    sure = claim(doubting(two_found, shoulder=0.99, elbow=0.99), 0.05)
    assert sure.effects == two_found.effects and sure.report["not_named"] == []


def test_what_is_doubtful_is_told_and_not_in_the_model(two_found):
    """The others are fitted again, and the error is that of what is named."""
    claimed = claim(doubting(two_found, shoulder=0.99, elbow=0.6), 0.05)
    (named,), (doubtful,) = claimed.report["effects"], claimed.report["not_named"]
    assert (named["effect"], named["probability"]) == ("joint_damping", 0.99)
    assert (doubtful["effect"], doubtful["probability"]) == ("joint_armature", 0.6)
    assert [e.name for e in claimed.effects] == ["joint_damping"]
    assert claimed.result.error.after > two_found.result.error.after
    assert claimed.report["explanations"] == two_found.report["explanations"]


def test_what_the_user_declared_stays_in_the_model(two_found):
    """Also beside an effect of the same kind on the same joint that is doubtful."""
    given = JointArmature("elbow", 0.005)
    state = replace(two_found.state, fixed=(given, *two_found.state.fixed))
    told = doubting(replace(two_found, state=state, declared=(given,)), shoulder=0.99, elbow=0.6)
    claimed = claim(told, 0.05)
    assert given in claimed.effects and [e.name for e in claimed.effects] == ["joint_armature", "joint_damping"]


def test_a_black_box_is_named_by_the_same_rate(two_found):
    box = ResidualNetwork("elbow", "v", (1.0,), (0.0,) * 4, 0.1)
    laws = LawReport(3.0, 1.0, [], NetworkFinding("elbow", ("v",), 0.5), (), (), "", 2.0)
    state = replace(two_found.state, fixed=(*two_found.state.fixed, box))
    given = replace(two_found, state=state, effects=state.effects, result=replace(two_found.result, laws=laws))
    claimed = claim(doubting(given, shoulder=0.99, elbow=0.99), 0.05)
    assert [e.key for e in claimed.result.not_named] == [("residual_network", "elbow")]
    assert box not in claimed.effects and claimed.result.laws.network is None
    assert [e.name for e in claimed.effects] == [e.name for e in two_found.effects]


def test_changes_of_what_is_not_named_go_too():
    change = dict(parameter="damping", unit="", kind="drift_over", first=0.1, last=0.2, at=None, episode=None, p=0.001,
                  removed_share=0.5, series=())  # fmt: skip
    found = [ChangeFinding("joint_damping", joint, **change) for joint in ("shoulder", "elbow")]
    left = without_changes_of(ChangeReport(4, found), {("joint_damping", "elbow")})
    assert left.tested == 4 and [f.target for f in left.found] == ["shoulder"]
    assert without_changes_of(None, set()) is None


def test_where_nothing_is_sure_something_is_missing_all_the_same(two_found):
    claimed = claim(doubting(two_found, shoulder=0.6, elbow=0.6), 0.05)
    assert claimed.verdict is Verdict.UNEXPLAINED_RESIDUAL and not claimed.effects
    assert len(claimed.report["not_named"]) == 2


def test_the_command_names_by_rate_and_says_what_it_left_out(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    hidden = ARM.replace('damping="0.05"', 'damping="0.25"')
    write_trajectories(tmp_path / "arm.h5", record(hidden))
    out = tmp_path / "found"
    options = ["--model", str(tmp_path / "arm.xml"), "--data", str(tmp_path / "arm.h5"), "--out", str(out)]
    assert main(["diagnose", *options, "--quick", "--threads", "1", "--fdr", "0.0001"]) == 0
    report, told = json.loads((out / "report.json").read_text()), capsys.readouterr().out
    assert report["effects"] == [] and report["not_named"][0]["effect"] == "joint_damping"
    assert "At a rate below 0.017 nothing is ever named" in told.replace("\n", " ")
    assert "Not named, as more than 0.0001" in told and "probable)" in told
    assert "Not named" in (out / "report.html").read_text()
    patched = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    assert patched.dof_damping[0] == pytest.approx(0.05)


def test_a_law_that_is_not_named_makes_nothing_needless():
    law = LawFinding("shoulder", "-a*v", "-0.5 v", "N·m", {}, ("v",), 0.9, (), 0.5, 0.4)
    laws = LawReport(3.0, 1.0, [law, replace(law, joint="elbow")], None, ["joint_damping(shoulder)"], (), "", 2.0)
    assert without_laws_on(laws, set()) == laws and without_laws_on(None, {"elbow"}) is None
    one = without_laws_on(laws, {"elbow"})
    assert [f.joint for f in one.found] == ["shoulder"] and one.needless == laws.needless
    none = without_laws_on(laws, {"elbow", "shoulder"})
    assert (list(none.found), list(none.needless), none.after) == ([], [], laws.before)


@pytest.mark.parametrize("rate", ["0", "1", "1.5", "nan"])
def test_a_rate_is_between_0_and_1(rate, tmp_path, capsys):
    assert main(["diagnose", "--model", "m.xml", "--data", "d.h5", "--out", str(tmp_path / "o"), "--fdr", rate]) != 0
    assert "fdr" in capsys.readouterr().err
