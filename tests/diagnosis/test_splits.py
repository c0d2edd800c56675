"""How often an effect is chosen as other episodes are held out."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm import ARM, found, record

from cli.main import main
from datamodules import write_trajectories
from idapt_pl.diagnosis import search
from idapt_pl.diagnosis.answer.split_report import SplitReport, SplitSearch
from idapt_pl.diagnosis.prepare import quarters
from idapt_pl.diagnosis.splits import chosen, with_splits
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.prediction.data import UnusableData
from idapt_pl.report.split_section import split_section, split_sentences

DAMPED = ARM.replace('damping="0.05"', 'damping="0.25"')
DAMPING, ARMATURE, MASS = ("joint_damping", "shoulder"), ("joint_armature", "elbow"), ("body_mass", "upper")
FEW = ["joint_damping", "joint_armature", "joint_frictionloss", "body_mass", "actuator_gain"]


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 12])
def test_every_episode_is_held_out_once(n):
    usable = np.arange(n) + 5
    parts = quarters(np.random.default_rng(0).random(n + 5), usable)
    assert sorted(np.concatenate(parts).tolist()) == usable.tolist()
    assert len(parts) == min(n, 4)


def test_what_is_there_is_chosen_whatever_is_held_out():
    diagnosis, effects = found(record(DAMPED, episodes=8), threads=1, candidates=FEW)
    splits = with_splits(diagnosis).result.splits
    held_out = [e for s in splits.searches for e in s.held_out_episodes]
    assert set(effects) == {DAMPING} and sorted(held_out) == list(range(8))
    (damping,) = splits.times_chosen()
    low, high = damping.ranges["damping"]
    assert damping.key == DAMPING and damping.times == 4 and not splits.unsteady()
    assert 0.22 < low < high < 0.28


def test_nothing_is_chosen_where_nothing_is_missing():
    diagnosis, effects = found(record(episodes=4), threads=1, candidates=FEW)
    splits = with_splits(diagnosis).result.splits
    assert not effects and not splits.times_chosen() and len(splits.searches) == 4
    assert split_sentences(splits) == ["Searched 4 times, other episodes held out each time: no effect was chosen."]


def test_episodes_that_the_user_chose_leave_no_others_to_hold_out():
    """With other parts than the quarters there is no telling which searches are new."""
    diagnosis, _ = found(record(episodes=4), threads=1, hold_out=[0, 1], fit=[2, 3])
    with pytest.raises(UnusableData, match="no other episodes"):
        with_splits(diagnosis)


def test_a_search_for_laws_keeps_the_count(monkeypatch):
    diagnosis, _ = found(record(DAMPED, episodes=8), threads=1, candidates=["joint_damping"], laws=False)
    counted = replace(diagnosis, result=replace(diagnosis.result, splits=COUNTED, runtime_s=3.0))
    monkeypatch.setattr(search, "search_laws", lambda context, state: SimpleNamespace(hint=None))
    monkeypatch.setattr(search, "add_laws", lambda context, *of: (diagnosis.state, diagnosis.result))
    assert search.with_laws(counted).result.splits is COUNTED and search.with_laws(counted).result.runtime_s == 3.0


def test_both_ends_of_a_joint_are_one_entry():
    ends = [Candidate(JointRange, "elbow", (end,), (x,), (0.1,)) for end, x in (("lower", -1.0), ("upper", 1.0))]
    state = SearchState((), tuple(AcceptedEffect(k, c, np.array([0.5 * k])) for k, c in enumerate(ends)), None)
    assert chosen(None, state) == {("joint_range", "elbow"): {"lower": 0.0, "upper": 0.5}}


COUNTED = SplitReport(
    (
        SplitSearch((0, 1), {ARMATURE: {"armature": 0.02}, DAMPING: {"damping": 0.2}}),
        SplitSearch((2, 3), {DAMPING: {"damping": 0.25}, MASS: {"mass": 0.7}}),
        SplitSearch((4, 5), {DAMPING: {"damping": 0.22}}),
        SplitSearch((6,), {DAMPING: {"damping": 0.21}, ARMATURE: {"armature": 0.03}}),
    )
)


def test_it_is_counted_and_what_half_of_the_searches_lack_is_doubted():
    entry = COUNTED.to_dict()
    assert json.loads(json.dumps(entry)) == entry
    assert [(t["target"], t["times"]) for t in entry["times_chosen"]] == [("shoulder", 4), ("elbow", 2), ("upper", 1)]
    assert entry["times_chosen"][0]["ranges"] == {"damping": [0.2, 0.25]}
    assert entry["searches"][3]["held_out_episodes"] == [6]
    assert [t.key for t in COUNTED.unsteady()] == [ARMATURE]


def test_in_words_and_as_a_table():
    chosen, besides, doubted = split_sentences(COUNTED)
    assert "shoulder in 4 and" in chosen and "elbow in 2." in chosen
    assert besides == "Chosen besides: mass of body upper in 1."
    assert "rotor inertia" in doubted and "damping" not in doubted
    text = re.sub(r"<[^>]+>", " ", split_section(COUNTED))
    assert "4 of 4" in text and "damping 0.2 to 0.25" in text and "mass 0.7" in text
    assert split_section(None) == "" and split_sentences(None) == []


def test_the_command_counts_and_refuses_what_does_not_go_together(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    write_trajectories(tmp_path / "arm.h5", record(DAMPED, episodes=4))
    files = ["--model", str(tmp_path / "arm.xml"), "--data", str(tmp_path / "arm.h5"), "--out", str(tmp_path / "out")]
    assert main(["diagnose", *files, "--splits", "--threads", "1", "--max-effects", "1"]) == 0
    assert "on joint shoulder in 4." in capsys.readouterr().out.replace("\n", " ")
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert len(report["splits"]["searches"]) == 4
    assert "Does it hang on the episodes held out?" in (tmp_path / "out/report.html").read_text()
    for more in (["--hold-out", "1"], ["--quick"]):
        with pytest.raises(SystemExit):
            main(["diagnose", *files, "--splits", *more])
        assert "--splits" in capsys.readouterr().err
