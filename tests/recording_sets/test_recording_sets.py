"""Several recordings of one robot: what changed between them is said, and nothing where nothing changed."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from cli.diagnose import command_line
from cli.diagnose_recordings import read_recordings
from cli.main import main
from datamodules import write_trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.estimation.intervals import clusters_of
from idapt_pl.recording_sets import RecordingSet, compare_sets, join_recordings
from idapt_pl.report.sets_section import comparison_section, comparison_sentences
from idapt_pl.stretches.stretch import marked_steps

sys.path.insert(0, str(ROOT / "tests" / "report"))
sys.path.insert(0, str(ROOT / "tests" / "diagnosis"))
from test_diagnosis_report import MOTOR, NOMINAL, SWING, record
from test_unexplained_forces import QUICK, recorded, spec_of


def joined(*dampings):
    """Files of swings with these dampings; other noise in each."""
    each = [record(d, episodes=3 + i) for i, d in enumerate(dampings)]
    return join_recordings([Path(f"{i}.h5") for i in range(len(each))], each)


@pytest.fixture(scope="module")
def comparisons():
    """Of three files in which the damping rises, and of two that are alike."""
    spec, made = mujoco.MjSpec.from_string(SWING.format(damping=NOMINAL, actuator=MOTOR)), []
    for dampings in ((0.05, 0.05, 0.07), (0.06, 0.06)):
        data, sets = joined(*dampings)
        made.append(compare_sets(diagnose(spec, data, candidates=["joint_damping"], threads=1), sets))
    return made


def test_values_that_differ_between_files_are_named(comparisons):
    risen, alike = comparisons
    (changed,) = risen.changed
    assert changed.value == ("joint_damping", "shoulder", "damping")
    assert changed.highest == "2.h5" and changed.sigmas > 5 and alike.changed == ()
    estimates = [float(next(iter(s.values.values())).estimate) for s in risen.sets]
    assert estimates == pytest.approx([0.05, 0.05, 0.07], rel=0.05)
    assert all(s.own <= s.common + 1e-6 and s.own < 1.3 for s in risen.sets)
    assert [list(s.recordings.episodes) for s in risen.sets] == [[0, 1, 2], [3, 4, 5, 6], [7, 8, 9, 10, 11]]


def test_the_comparison_in_words_and_on_the_page(comparisons):
    risen, alike = comparisons
    assert "rose from" in comparison_sentences(risen)[0] and "in 2.h5" in comparison_sentences(risen)[0]
    assert comparison_sentences(alike) == ["None of the values found differs surely between the 2 files."]
    assert "take each file's own values" in comparison_sentences(risen)[1]
    page = comparison_section(risen)
    assert page.count("<svg") == 1 and "File by file" in page and comparison_section(None) == ""


def test_files_are_judged_by_forces_where_the_search_was():
    """A file of the held-out episode alone has the errors of the report."""
    out = diagnose(spec_of(), recorded(), threads=1, settings=QUICK, candidates=["joint_damping"])
    assert out.by_forces and out.result.error.held_out_episodes == [3]
    comparison = compare_sets(out, [RecordingSet("fitted", 0, 3), RecordingSet("held out", 3, 4)])
    fitted, held_out = comparison.sets
    assert (held_out.before, held_out.common) == (out.result.error.before, out.result.error.after)
    found = {(*e.key, "damping"): e.parameters["damping"] for e in out.result.effects}
    assert found.keys() == fitted.values.keys()
    for name, p in found.items():
        assert p.ci95[0] < fitted.values[name].estimate < p.ci95[1]
    assert "deviations of the force that nothing explains" in comparison_section(comparison)


def test_windows_of_few_episodes_are_clustered_by_parts_of_them():
    episode, start = np.repeat([0, 1], 20), np.tile(np.arange(0, 100, 5), 2)
    clusters = clusters_of(episode, start)
    assert len(np.unique(clusters)) == 8 and not set(clusters[:20]) & set(clusters[20:])
    np.testing.assert_array_equal(clusters_of(np.arange(9), np.zeros(9)), np.arange(9))


def test_files_that_do_not_go_together_are_refused():
    a, b = record(0.01, episodes=1), record(0.01, episodes=1)
    with pytest.raises(ValueError, match=r"b.h5: its control period is 0.04 s, that of a.h5 is 0.02 s"):
        join_recordings([Path("a.h5"), Path("b.h5")], [a, replace(b, dt=0.04)])
    with pytest.raises(ValueError, match=r"a.h5 is given twice"):
        join_recordings([Path("a.h5"), Path("a.h5")], [a, b])


def two_files(tmp_path):
    """Options of the command for the recordings old.h5 and new.h5, of three episodes each."""
    (tmp_path / "nominal.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    for name, damping in (("old", 0.05), ("new", 0.08)):
        write_trajectories(tmp_path / f"{name}.h5", record(damping, episodes=3))
    files = [str(tmp_path / f"{n}.h5") for n in ("old", "new")]
    return ["--model", str(tmp_path / "nominal.xml"), "--data", *files, "--out", str(tmp_path / "out")]


def test_the_command_takes_several_files_and_conditions(tmp_path, capsys):
    args = two_files(tmp_path)
    assert main(["diagnose", *args, "--candidates", "joint_damping", "--without", "time > 1.5", "--threads", "1"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [r["file"] for r in report["recordings"]] == ["old.h5", "new.h5"] and len(report["changed"]) == 1
    assert report["left_out"]["conditions"] == ["without time > 1.5"]
    assert {s["begin_s"] for s in report["left_out"]["stretches"]} == {1.5}
    assert report["recordings"][0]["deployment_faults"]["faults"] == []
    said, text = capsys.readouterr().out, (tmp_path / "out" / "settings.md").read_text()
    assert "rose from" in said and "Left out as asked" in said
    assert "| joint | shoulder | damping | 0.01 |" in text and "ImplicitActuatorCfg" in text
    page = (tmp_path / "out" / "report.html").read_text()
    for words in ("In a minute", "File by file", "Left out", "Values to set", "What to do next", "next-joint_damping"):
        assert words in page, words


def test_conditions_count_episodes_through_all_files(tmp_path, capsys):
    args = two_files(tmp_path)
    each = read_recordings(command_line().parse_args([*args, "--without", "episode == 4", "--without", "episode > 5"]))
    assert [[bool(marked_steps(e).all()) for e in data] for data in each] == [[False] * 3, [False, True, False]]
    assert capsys.readouterr().out == "--without 'episode > 5' leaves nothing out; episode is 0, 1, 2, 3, 4, 5\n"
    old, new = read_recordings(command_line().parse_args([*args, "--only", "episode < 3"]))
    assert not any(marked_steps(e).any() for e in old) and all(marked_steps(e).all() for e in new)


@pytest.mark.parametrize("alone", [False, True])
def test_a_file_of_fragments_has_a_row_without_values(tmp_path, capsys, alone):
    """What was found is worth more than a comparison that cannot be made."""
    args = two_files(tmp_path)
    write_trajectories(tmp_path / "short.h5", record(0.05, episodes=2, steps=4))
    args.insert(args.index("--out"), str(tmp_path / "short.h5"))
    more = ["--only", "episode < 3"] if alone else []
    assert main(["diagnose", *args, *more, "--candidates", "joint_damping", "--threads", "1"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    _, new, short = report["recordings"]
    assert short["error"] == {"before": None, "common": None, "own": None} and short["effects"] == []
    assert (new["effects"] == []) == alone and len(report["changed"]) == (0 if alone else 1)
    said = " ".join(capsys.readouterr().out.split())
    assert f"is as long as a forecast: {'new.h5, ' if alone else ''}short.h5." in said
    assert "File by file" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--only", "stat == 2"], "has no channel 'stat'"), (["--without", "time >= 0"], "leave no control step"),
        (["--only", "import os"], "cannot be read"), (["--actuators", "motor"], "has actuators already"),
    ],
)  # fmt: skip
def test_bad_options_are_clear_errors(tmp_path, capsys, more, words):
    (tmp_path / "nominal.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(tmp_path / "m.h5", record(NOMINAL, episodes=2))
    args = ["--model", str(tmp_path / "nominal.xml"), "--data", str(tmp_path / "m.h5"), "--out", str(tmp_path / "out")]
    assert main(["diagnose", *args, *more]) == 1
    assert words in " ".join(capsys.readouterr().err.split()) and not (tmp_path / "out").exists()


def test_a_urdf_with_torques_gets_a_diagnosis(tmp_path, capsys):
    urdf = """<robot name="swing"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.2"/>
    <mass value="0.5"/><inertia ixx="0.0073" iyy="0.0073" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="shoulder" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <dynamics damping="0.01"/></joint></robot>"""
    (tmp_path / "swing.urdf").write_text(urdf)
    write_trajectories(tmp_path / "m.h5", record(0.06))
    args = ["diagnose", "--model", str(tmp_path / "swing.urdf"), "--data", str(tmp_path / "m.h5")]
    assert main([*args, "--out", str(tmp_path / "no")]) == 1
    assert "--actuators motor (torques)" in " ".join(capsys.readouterr().err.split())
    more = ["--actuators", "motor", "--candidates", "joint_damping", "--out", str(tmp_path / "out"), "--threads", "1"]
    more.append("--no-laws")  # the two models differ in more than damping
    assert main([*args, *more]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    damping = [e for e in report["effects"] if e["effect"] == "joint_damping"]
    assert damping[0]["parameters"]["damping"]["estimate"] == pytest.approx(0.06, rel=0.1)
    assert any("no friction given" in n for n in report["model_notes"])
    assert "What the model&#x27;s file lost" in (tmp_path / "out" / "report.html").read_text()
