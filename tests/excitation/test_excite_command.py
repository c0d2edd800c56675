"""`idapt excite`: files that a robot, a program and a person can read, and errors in one sentence with exit code 2."""

import csv
import json

import imageio.v3
import numpy as np
import pytest
from arms import DAMPING, FRICTION, SERVO, report_folder

from cli.excite import read_spans
from cli.main import main

QUICK = ["--duration", "2", "--seconds", "1", "--threads", "1"]


def excite(folder, *options):
    arguments = ["--model", folder / "nominal.xml", "--report", folder / "diagnosis", "--out", folder / "next.csv"]
    return main(["excite", *map(str, arguments), *QUICK, *options])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = report_folder(tmp_path_factory.mktemp("excite"), DAMPING, FRICTION)
    assert excite(folder, "--velocity", "3", "--position", "shoulder=-0.6:0.6") == 0
    return folder


def test_the_commands_are_a_table_with_names_and_units(written):
    head, *rows = csv.reader((written / "next.csv").open())
    assert head == ["time [s]", "servo [rad]"]
    time, command = np.array(rows, float).T
    assert time == pytest.approx(0.02 * np.arange(101)) and command[0] == command[-1] == 0
    assert 0.1 < np.abs(command).max() <= 1.4


def test_the_json_says_what_is_told_apart_and_within_which_limits(written):
    entry = json.loads((written / "next.json").read_text())
    assert entry["schema"] == "idapt.excitation/1" and entry["inseparable"] == []
    (pair,) = entry["pairs"]
    assert pair["told_apart"] and pair["separation"] > entry["threshold"] == 1.5
    assert pair["plays"] == 2, "one to fit, one to judge on"
    assert entry["limits"]["position"] == {"shoulder": [-0.6, 0.6]} and entry["limits"]["velocity"] == {"shoulder": 3.0}
    assert all(m["room"] >= 0 for m in entry["margins"])
    (damping,) = entry["parameters"]
    assert damping["half_width_now"] == pytest.approx(0.06) and damping["half_width_from_motion"] > 0


def test_the_page_has_all_parts_and_fetches_nothing(written):
    page = (written / "next.html").read_text()
    for part in ("Explanations", "What it tells apart", "The motion", "Safety", "What to do with it"):
        assert f"<h2>{part}</h2>" in page
    assert "separation so far" in page
    assert "<script" not in page and "http" not in page.replace("http://www.w3.org", "")
    assert (written / "next.png").read_bytes().startswith(b"\x89PNG")
    assert not (written / "next.gif").exists()  # the model has no camera


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--velocity", "fast"], "expected a number above 0 or LOW:HIGH"),
        (["--fastest", "20"], "--fastest: expected 0.5 (once in --duration) to 12.5 Hz"),
        (["--velocity", "elbow=1"], "the model has no 'elbow'"),
        (["--position", "1:0.5"], "expected a number above 0 or LOW:HIGH"),
        (["--position", "5:6"], "nothing is left for shoulder"),
        (["--min-height", "2"], "limits allow no motion"),
        (["--start", "0", "0"], "--start: expected 1 positions"),
        (["--base", "none.csv"], "no such file"),
        (["--out", "next.txt"], "must end in .csv"),
        (["--report", "nowhere"], "no such folder"),
        (["--duration", "-1"], "duration"),
        (["--duration", "0.2"], "too short"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_exit_code_2(written, capsys, options, said):
    before = {p.name: p.read_bytes() for p in written.glob("next.*")}
    assert excite(written, *options) == 2
    error = capsys.readouterr().err
    assert said in error and error.startswith("idapt excite: ") and error.count("\n") == 1
    assert before == {p.name: p.read_bytes() for p in written.glob("next.*")}


def test_a_model_with_a_camera_has_a_clip_and_an_old_one_goes_where_none_can_be_drawn(tmp_path, monkeypatch, caplog):
    camera = '<worldbody><camera pos="0 -2 0.5" xyaxes="1 0 0 0 0 1"/>'
    report_folder(tmp_path, DAMPING, FRICTION, xml=SERVO.replace("<worldbody>", camera))
    assert excite(tmp_path) == 0
    clip = imageio.v3.imread(tmp_path / "next.gif")
    assert clip.shape[1:3] == (240, 240) and np.ptp(clip[0]) > 0 and not np.array_equal(clip[0], clip[len(clip) // 2])
    assert "data:image/gif" in (tmp_path / "next.html").read_text()

    def no_gl(*size):
        raise RuntimeError("no GL here")

    monkeypatch.setattr("mujoco.Renderer", no_gl)
    assert excite(tmp_path) == 0
    assert not (tmp_path / "next.gif").exists() and "no GL here" in caplog.text
    assert "data:image/gif" not in (tmp_path / "next.html").read_text()


def test_a_report_with_one_explanation_is_good_for_estimates_alone(tmp_path, capsys):
    report_folder(tmp_path, DAMPING)
    assert excite(tmp_path) == 2 and "--goal estimate" in capsys.readouterr().err
    assert excite(tmp_path, "--goal", "estimate") == 0
    assert json.loads((tmp_path / "next.json").read_text())["pairs"] == []
    assert "separation so far" not in (tmp_path / "next.html").read_text(), "there is nothing to tell apart"


def test_a_span_may_begin_with_a_minus_and_contact_may_be_allowed(tmp_path):
    report_folder(tmp_path, DAMPING, FRICTION)
    assert excite(tmp_path, "--position", "-0.5:0.5", "--contact", "--velocity", "3") == 0
    limits = json.loads((tmp_path / "next.json").read_text())["limits"]
    assert limits["position"] == {"shoulder": [-0.5, 0.5]} and limits["no_contact"] is False


def test_of_a_urdf_the_reports_copy_is_taken_which_has_actuators(tmp_path):
    report_folder(tmp_path, DAMPING, FRICTION)
    given = tmp_path / "nominal.xml"
    (tmp_path / "diagnosis/unrepaired.xml").write_text(given.read_text())
    given.write_text("<robot name='arm'><link name='base'/></robot>")
    assert excite(tmp_path, "--velocity", "3") == 0


def test_limits_are_read_as_they_are_written():
    assert read_spans("position", ["1.5", "elbow=0:2", "wrist=-1:-0.5"]) == {
        "*": (-1.5, 1.5), "elbow": (0.0, 2.0), "wrist": (-1.0, -0.5)
    }  # fmt: skip
