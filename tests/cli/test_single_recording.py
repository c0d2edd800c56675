"""A single recording of a robot is enough for `idapt diagnose`: it is cut in time. And there is a quick look."""

import json
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import ROOT

from cli.diagnose import command_line
from cli.diagnose_recordings import search_settings
from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from datamodules.trajectories import cut_in_time
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import QUICK_SETTINGS

sys.path.insert(0, str(ROOT / "tests" / "report"))
from test_diagnosis_report import MOTOR, NOMINAL, SWING, record


def test_parts_share_the_observation_where_they_meet():
    time, marks = np.linspace(0, 1, 11), np.arange(10) > 6
    episode = Episode(
        np.arange(20, dtype=np.float32).reshape(10, 2), {"qpos": np.arange(11.0)[:, None]}, timestamps=time,
        infos={"left_out": marks, "room": np.arange(11), "name": np.arange(3)},
    )  # fmt: skip
    parts = cut_in_time(Trajectories((episode,), 0.1), [0, 3, 7, 10]).episodes
    assert [len(p) for p in parts] == [3, 4, 3]
    assert np.array_equal(np.concatenate([p.actions for p in parts]), episode.actions)
    assert [p.observations["qpos"][0, 0] for p in parts] == [0, 3, 7]
    assert [p.observations["qpos"][-1, 0] for p in parts] == [3, 7, 10]
    assert parts[1].timestamps == pytest.approx(time[3:8])
    assert np.array_equal(np.concatenate([p.infos["left_out"] for p in parts]), marks)
    assert [len(p.infos["room"]) for p in parts] == [4, 5, 4] and len(parts[2].infos["name"]) == 3


def test_one_recording_is_diagnosed_and_the_user_told_where_it_was_cut(tmp_path, capsys):
    (tmp_path / "m.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(tmp_path / "one.h5", record(0.07, episodes=1, steps=200))
    arguments = ["--model", tmp_path / "m.xml", "--data", tmp_path / "one.h5", "--out", tmp_path / "d"]
    assert main(["diagnose", *map(str, arguments), "--candidates", "joint_damping", "--threads", "1"]) == 0
    assert "one episode: cut in time into 4" in capsys.readouterr().out
    report = json.loads((tmp_path / "d/report.json").read_text())
    (found,) = report["effects"]
    assert found["parameters"]["damping"]["estimate"] == pytest.approx(0.07, rel=0.1)
    assert len(report["error"]["fit_episodes"]) == 3 and len(report["error"]["held_out_episodes"]) == 1


def test_what_is_kept_of_one_recording_is_cut(tmp_path, capsys):
    """Of the whole in four parts, three would be left out."""
    (tmp_path / "m.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(tmp_path / "one.h5", record(0.07, episodes=1, steps=800))
    arguments = ["--model", tmp_path / "m.xml", "--data", tmp_path / "one.h5", "--out", tmp_path / "d"]
    more = ["--candidates", "joint_damping", "--threads", "1", "--only", "0.5 < time < 4"]
    assert main(["diagnose", *map(str, arguments), *more]) == 0
    assert "episode 0 from 0 s, 1 from 1.38 s, 2 from 2.24 s, 3 from 3.1 s on" in capsys.readouterr().out
    report = json.loads((tmp_path / "d/report.json").read_text())
    assert report["effects"][0]["parameters"]["damping"]["estimate"] == pytest.approx(0.07, rel=0.1)
    assert len(report["error"]["fit_episodes"]) == 3 and len(report["error"]["held_out_episodes"]) == 1


def test_one_that_is_too_short_to_cut_says_that_more_are_needed(tmp_path, capsys):
    (tmp_path / "m.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(tmp_path / "one.h5", record(0.07, episodes=1, steps=30))
    arguments = ["--model", tmp_path / "m.xml", "--data", tmp_path / "one.h5", "--out", tmp_path / "d"]
    assert main(["diagnose", *map(str, arguments)]) == 1
    assert "at least two are needed" in capsys.readouterr().err


def test_a_quick_look_finds_the_largest_effect_and_says_what_it_did_not_try(tmp_path, capsys):
    (tmp_path / "m.xml").write_text(SWING.format(damping=NOMINAL, actuator=MOTOR))
    write_trajectories(tmp_path / "some.h5", record(0.07))
    arguments = ["--model", tmp_path / "m.xml", "--data", tmp_path / "some.h5", "--out", tmp_path / "d"]
    assert main(["diagnose", "--quick", *map(str, arguments), "--threads", "1"]) == 0
    shown = capsys.readouterr().out
    assert "A quick look. Not tried: more than two effects" in shown and "laws of force" in shown
    report = json.loads((tmp_path / "d/report.json").read_text())
    assert [(e["effect"], e["target"]) for e in report["effects"]] == [("joint_damping", "shoulder")]
    assert report["not_tried"] and "changes" not in report and "laws" not in report
    assert "What was not tried?" in (tmp_path / "d/report.html").read_text()


@pytest.mark.parametrize(("given", "most"), [([], 8), (["--max-effects", "12"], 12), (["--max-effects", "1"], 1)])
def test_as_many_effects_as_were_asked_for_and_two_at_a_quick_look(given, most):
    args = ["--data", "m.h5", "--out", "d", *given]
    assert search_settings(command_line().parse_args(args)).max_effects == most
    assert search_settings(command_line().parse_args([*args, "--quick"])).max_effects == min(most, 2)


def test_time_for_a_quick_look_is_up_after_half_of_it():
    spec = mujoco.MjSpec.from_string(SWING.format(damping=NOMINAL, actuator=MOTOR))
    found = diagnose(spec, record(0.07), settings=replace(QUICK_SETTINGS, seconds=0.0), threads=1)
    assert len(found.result.effects) == 1, "the first round is made whatever the time"
    assert not diagnose(spec, record(0.07), candidates=["joint_damping"], threads=1).result.not_tried
