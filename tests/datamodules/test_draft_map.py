"""`idapt import --draft-map`: a draft is right where names and numbers tell, and a comment where they do not."""

import numpy as np
import pytest
import yaml
from test_import import MODEL, arrays, recorded, run, write_csv, write_json_mcap
from test_import_logs import write_db3, write_jsonl, write_ulog

from cli.import_ import read_layout
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from datamodules.recordings import RecordingError, draft_map, read_mapping, write_draft
from datamodules.recordings.draft_names import COMMAND, OTHER_KIND, POSITION, VELOCITY, kind_of, named_unit
from datamodules.recordings.draft_text import draft_text, quoted

ROWS = 200


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "nominal.xml"
    path.write_text(MODEL)
    return path


def drafted(path, model):
    """The draft as data, and its text."""
    text = draft_text(draft_map(path, read_layout(model)))
    return yaml.safe_load(text), text


def motion():
    """The usual motion, for longer."""
    return recorded(ROWS, 0.01)


# --- names ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "kind", "unit"),
    [
        ("shoulder_deg", POSITION, "deg"), ("elbow_counts", POSITION, "counts"), ("joint_pos[0]", POSITION, ""),
        ("observation.state[elbow.pos]", POSITION, ""), ("/joint_states.position[elbow]", POSITION, ""),
        ("lift_mm", POSITION, "mm"), ("arm.q[3]", POSITION, ""), ("x_pos_m", POSITION, "m"),
        ("shoulder_dps", VELOCITY, "deg/s"), ("elbow_rpm", VELOCITY, "rpm"), ("vel_rad_s", VELOCITY, "rad/s"),
        ("wheelSpeed_rad/s", VELOCITY, "rad/s"), ("q_dot[0]", VELOCITY, ""), ("lift_vel_mm_per_s", VELOCITY, "mm/s"),
        ("tau_mNm", COMMAND, "mNm"), ("motor_current_mA", COMMAND, "mA"), ("elbow_des_pos_deg", COMMAND, "deg"),
        ("pwm_pct", COMMAND, "%"), ("cmd_V", COMMAND, "V"), ("elbow_clipped_tau", COMMAND, ""),
        ("motor_temp", OTHER_KIND, ""), ("header.stamp", OTHER_KIND, ""), ("supply_volts", OTHER_KIND, ""),
    ],
)  # fmt: skip
def test_names_tell_kind_and_unit(name, kind, unit):
    assert kind_of(name) == kind
    assert kind == OTHER_KIND or named_unit(name, kind)[0] == unit


@pytest.mark.parametrize(
    "name", ["a", "a b", "/j.position[0]", "on", "3", "a: b", "#x", "né", "a\nb", '"', "\x7f", "{", ""]
)
def test_any_name_is_written_so_that_it_is_read_as_it_was(name):
    assert yaml.safe_load(f"{{column: {quoted(name)}, {quoted(name)}: 1}}") == {"column": name, name: 1}


# --- formats --------------------------------------------------------------------------------------------


def in_csv(folder):
    c = motion()
    columns = {"stamp_ms": 5000 + np.round(1000 * c["t"]).astype(int), "slider_mm": 1000 * c["x"]}
    columns |= {"hinge_deg": np.rad2deg(c["q"]), "slider_vel_mm_s": 1000 * c["v"], "hinge_dps": np.rad2deg(c["w"])}
    columns |= {"push_N": c["u"], "hinge_mNm": 1000 * c["tau"], "motor_temp": np.full(ROWS, 40), "note": ["ok"] * ROWS}
    return write_csv(folder / "run.csv", columns)


def in_npz(folder):
    a = arrays(ROWS)
    np.savez(folder / "run.npz", t=a["t"], qpos=a["q"], qvel=a["v"], ctrl=a["u"])
    return folder / "run.npz"


def in_hdf5(folder):
    a = arrays(ROWS)
    episode = Episode(a["u"][:-1].astype(np.float32), {"qpos": a["q"], "qvel": a["v"]}, timestamps=a["t"])
    write_trajectories(folder / "run.h5", Trajectories((episode,), 0.02))
    return folder / "run.h5"


def in_lerobot(folder):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    a = arrays(ROWS)
    state = np.concatenate([a["q"], a["v"]], 1)
    table = pyarrow.table({"observation.state": state.tolist(), "action": a["u"].tolist(), "timestamp": a["t"]})
    parquet.write_table(table, folder / "run.parquet")
    return folder / "run.parquet"


def in_jsonl(folder):
    rows = [
        {"time": t, "slider": {"pos": x, "vel": v}, "hinge": {"pos": q, "vel": w}, "cmd": {"push": u, "hinge": tau}}
        for t, x, v, q, w, u, tau in zip(*(map(float, column) for column in motion().values()), strict=True)
    ]
    return write_jsonl(folder / "run.jsonl", rows)


def in_mcap(folder):
    pytest.importorskip("mcap")
    return write_json_mcap(folder / "run.mcap", rows=ROWS)


def in_db3(folder):
    pytest.importorskip("mcap_ros2")
    return write_db3(folder / "run.db3", rows=ROWS)


def in_ulog(folder):
    pytest.importorskip("pyulog")
    return write_ulog(folder / "run.ulg", rows=ROWS)


def test_what_is_to_be_given_next_names_the_actuators_too(tmp_path, capsys):
    model, path = tmp_path / "arm.xml", tmp_path / "log.csv"
    model.write_text("<mujoco><worldbody><body><joint name='elbow'/><geom size='.1'/></body></worldbody></mujoco>")
    path.write_text("time,elbow_position,elbow_effort\n" + "\n".join(f"{0.01 * i},{0.1 * i},1" for i in range(9)))
    drafted = ["import", path, "--model", model, "--draft-map", tmp_path / "map.yaml"]
    code, printed = run(drafted, capsys)
    assert code == 0 and "has no actuators, so nothing is taken for a command: say what drives it" in printed.out
    (tmp_path / "map.yaml").unlink()
    code, printed = run([*drafted, "--actuators", "motor"], capsys)
    assert code == 0 and "--actuators motor --dry-run" in printed.out and "has no actuators" not in printed.out


def test_of_several_recordings_it_is_said_that_one_was_looked_at(model, tmp_path, capsys):
    first, second = (write_csv(tmp_path / f"{name}.csv", motion()) for name in "ab")
    for name, files, said in (("one", [first], False), ("two", [first, second], True)):
        code, printed = run(["import", *files, "--model", model, "--draft-map", tmp_path / f"{name}.yaml"], capsys)
        assert code == 0 and ("only that one of 2 recordings was looked at" in printed.out) == said


@pytest.mark.parametrize("write", [in_csv, in_npz, in_hdf5, in_lerobot, in_jsonl, in_mcap, in_db3, in_ulog])
def test_a_draft_is_a_map_that_import_reads_as_it_is(write, model, tmp_path, capsys):
    path, draft, out = write(tmp_path), tmp_path / "map.yaml", tmp_path / "measured.h5"
    code, printed = run(["import", path, "--model", model, "--draft-map", draft], capsys)
    assert code == 0 and "to fill in" not in printed.out and f"--map {draft}" in printed.out
    arguments = ["import", path, "--model", model, "--map", draft, "--out", out]
    code, printed = run(arguments, capsys)
    assert code == 0 and "note: joint" not in printed.out
    (episode,) = read_trajectories(out)
    c = motion() if write in (in_csv, in_jsonl) else recorded(ROWS)
    n = len(episode) + 1  # in rows of topics the first may be missing
    np.testing.assert_allclose(episode.observations["qpos"], np.stack([c["x"], c["q"]], 1)[-n:], atol=1e-6)
    np.testing.assert_allclose(episode.observations["qvel"], np.stack([c["v"], c["w"]], 1)[-n:], atol=1e-6)
    if write is not in_ulog:  # its first instance of commands is as good a guess
        np.testing.assert_allclose(episode.actions, np.stack([c["u"], c["tau"]], 1)[-n:-1], atol=1e-4)


def test_every_guess_says_why_and_what_is_left_is_listed(model, tmp_path):
    content, text = drafted(in_csv(tmp_path), model)
    entries = [line for line in text.splitlines() if "{column:" in line]
    assert len(entries) == 7 and all("  # " in line for line in entries)
    assert "deg in its name" in text and "the model's range is -3 to 3" in text
    assert text.rstrip().endswith("#   motor_temp, note")
    assert content["joints"]["hinge"]["velocity"] == {"column": "hinge_dps", "unit": "deg/s"}


# --- numbers --------------------------------------------------------------------------------------------


def test_units_come_from_ranges_and_slopes_where_names_have_none(model, tmp_path):
    c = motion()
    columns = {"t": c["t"] * 1e6, "slider": c["x"] * 1000, "hinge": np.rad2deg(c["q"]), "a": -60 / 6.2831853 * c["w"]}
    content, text = drafted(write_csv(tmp_path / "run.csv", columns), model)
    assert content["time"] == {"column": "t", "unit": "us"}
    assert content["joints"]["slider"] == {"position": {"column": "slider", "unit": "mm"}}
    assert content["joints"]["hinge"]["position"] == {"column": "hinge", "unit": "deg"}
    assert content["joints"]["hinge"]["velocity"] == {"column": "a", "unit": "rpm", "sign": -1}
    assert "against the position's slope" in text and content["actuators"] is None
    assert "# velocity: {column: ...}  # not found" in text


def test_joints_that_the_recording_calls_otherwise_go_by_their_place(model, tmp_path):
    c = motion()
    rows = [
        {"t": float(t), "state": {"name": ["pan", "lift"], "position": [float(x), float(q)]}}
        for t, x, q in zip(c["t"], c["x"], c["q"], strict=True)
    ]
    content, text = drafted(write_jsonl(tmp_path / "run.jsonl", rows), model)
    columns = [content["joints"][name]["position"]["column"] for name in ("slider", "hinge")]
    assert columns == ["state.position[pan]", "state.position[lift]"] and text.count("BY ITS PLACE ONLY") == 2


def test_what_a_controller_wanted_is_no_torque_and_a_number_alone_is_no_joint(tmp_path):
    model, c = tmp_path / "arm.xml", motion()
    motors = '<motor name="m1" joint="joint1"/><motor name="m2" joint="joint2"/>'
    joints = [f'<body><joint name="joint{k}" axis="0 1 0"/><geom size=".1"/>{{}}</body>' for k in (1, 2)]
    bodies = joints[0].format(joints[1].format(""))
    model.write_text(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>")
    columns = {"t": c["t"], "k1_store": 3 * c["u"], "k2_store": c["u"], "k3_store": c["tau"]}
    for k in (1, 2):
        columns |= {f"arm{k}_des_pos": c["q"], f"arm{k}_pos": k * c["q"], f"arm{k}_tau": k * c["u"]}
    got, _ = drafted(write_csv(tmp_path / "run.csv", columns), model)
    assert [got["joints"][f"joint{k}"]["position"]["column"] for k in (1, 2)] == ["arm1_pos", "arm2_pos"]
    assert [got["actuators"][f"m{k}"]["column"] for k in (1, 2)] == ["arm1_tau", "arm2_tau"]


def test_two_arrays_that_would_do_equally_well_are_left_to_the_person(model, tmp_path):
    a = arrays(ROWS)
    np.savez(tmp_path / "run.npz", t=a["t"], qpos_left=a["q"], qpos_right=2 * a["q"])
    made = draft_map(tmp_path / "run.npz", read_layout(model))
    assert made.positions["slider"].entry is None and "qpos_left[0]" in made.left


@pytest.mark.parametrize("counts", [1000, 4096, 16384])
def test_counts_a_turn_come_from_the_velocity(counts, model, tmp_path):
    c = motion()
    columns = {"t": c["t"], "slider_pos": c["x"], "hinge_enc": np.round(c["q"] / 2 / np.pi * counts) + 3 * counts}
    known = columns | {"hinge_rad_s": c["w"]}
    content, _ = drafted(write_csv(tmp_path / "run.csv", known), model)
    assert content["joints"]["hinge"]["position"]["unit"] == f"counts:{counts}"
    _, text = drafted(write_csv(tmp_path / "run.csv", columns), model)
    assert "NO MORE THAN A GUESS" in text


@pytest.mark.parametrize(
    ("scale", "start", "unit"),
    [
        (1, 0, "s"),
        (1000, 0, "ms"),
        (10**6, 0, "us"),
        (10**9, 0, "ns"),
        (1, 1_700_000_000, "s"),
        (10**9, 1_700_000_000, "ns"),
    ],
)
def test_unit_of_times_comes_from_their_size(scale, start, unit, model, tmp_path):
    c = motion()
    t = c["t"] + start if scale == 1 else np.round((c["t"] + start) * scale).astype(np.int64)
    np.savez(tmp_path / "run.npz", time=t, slider=c["x"], hinge=c["q"])
    content, _ = drafted(tmp_path / "run.npz", model)
    assert content["time"] == {"column": "time", "unit": unit}


def test_a_table_without_a_header_and_one_with_lines_before_it(model, tmp_path):
    c = motion()
    path = write_csv(
        tmp_path / "run.csv", {"t": c["t"], "slider": c["x"], "hinge": c["q"]}, before="rig 3, 2024\nbeta\n"
    )
    content, _ = drafted(path, model)
    assert content["skip_rows"] == 2 and content["joints"]["slider"]["position"]["column"] == "slider"
    path.write_text("\n".join(path.read_text().splitlines()[3:]))
    content, text = drafted(path, model)
    assert content["header"] is False and "# time: {column: ..., unit: s}" in text


def test_episodes_and_slips_of_the_clock_are_seen(model, tmp_path):
    c = motion()
    columns = {k: np.concatenate([v, v]) for k, v in {"t": c["t"], "slider": c["x"], "hinge": c["q"]}.items()}
    content, text = drafted(write_csv(tmp_path / "run.csv", columns | {"run": [1] * ROWS + [2] * ROWS}), model)
    assert content["episodes"] == {"column": "run"} and "increases but for 1 rows, for which there is --repair" in text


# --- what cannot be guessed -----------------------------------------------------------------------------


def test_what_is_not_told_is_commented_out_and_named(model, tmp_path, capsys):
    rng = np.random.default_rng(0)
    path = write_csv(tmp_path / "run.csv", {"alpha": rng.normal(size=50), "beta": rng.normal(size=50)})
    draft = tmp_path / "map.yaml"
    code, printed = run(["import", path, "--model", model, "--draft-map", draft], capsys)
    missing = "time, joints.slider.position, joints.hinge.position, actuators.push, actuators.hinge"
    assert code == 0 and f"to fill in: {missing}" in printed.out
    text = draft.read_text()
    assert "# time: {column: ..., unit: s}" in text and "#   alpha, beta" in text
    with pytest.raises(RecordingError, match=r"map\.yaml: expected either time"):
        read_mapping(draft)
    filled = text.replace("# time: {column: ..., unit: s}", "dt: 0.01").replace("# position", "position")
    filled = filled.replace("  # slider:", "  slider:").replace("  # hinge:", "  hinge:").replace("# push", "push")
    for column in ("alpha", "beta", "alpha", "beta"):
        filled = filled.replace("{column: ...", f"{{column: {column}", 1)
    draft.write_text(filled)
    assert list(read_mapping(draft).columns()) == ["alpha", "beta", "alpha", "beta"]


def test_a_draft_is_never_written_over_a_file(model, tmp_path, capsys):
    draft = tmp_path / "map.yaml"
    draft.write_text("mine")
    code, printed = run(["import", in_csv(tmp_path), "--model", model, "--draft-map", draft], capsys)
    assert code == 1 and "is there already" in printed.err and draft.read_text() == "mine"
    made = draft_map(tmp_path / "run.csv", read_layout(model))
    with pytest.raises(RecordingError, match="is there already"):
        write_draft(draft, made)


def test_a_draft_needs_a_model_and_no_map(model, tmp_path, capsys):
    path = in_csv(tmp_path)
    code, printed = run(["import", path, "--draft-map", tmp_path / "map.yaml"], capsys)
    assert code == 2 and "--draft-map needs --model" in printed.err
    code, printed = run(["import", path, "--model", model], capsys)
    assert code == 2 and "--map --draft-map" in printed.err


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("t;q_sh;q_el\n0,00;1,5;2,0\n0,01;1,25;2,5\n", "column 't', line 2: expected a number, got '0,00'"),
        ("t;q_sh;q_el\n0;;2,0\n1;1.5;3\n", "column 'q_el', line 2: expected a number, got '2,0'"),
        ("0,00;1,5;2,0\n0,01;1,25;2,5\n", "line 2: '01;1' stands between two commas"),
    ],
)
def test_decimal_commas_are_an_error_and_no_separators(text, wrong, model, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=f"{wrong}; write decimals with a point"):
        draft_map(path, read_layout(model))


def test_a_file_of_texts_has_nothing_to_guess_from(model, tmp_path):
    (tmp_path / "run.csv").write_text("a,b\nx,y\nz,w\n")
    with pytest.raises(RecordingError, match=r"run\.csv: no column holds numbers"):
        draft_map(tmp_path / "run.csv", read_layout(model))


def test_a_free_joint_is_left_to_the_person(tmp_path):
    (tmp_path / "free.xml").write_text(
        '<mujoco><worldbody><body><freejoint name="root"/><geom size="1"/></body></worldbody></mujoco>'
    )
    _, text = drafted(in_csv(tmp_path), tmp_path / "free.xml")
    assert "# position: {column: [...]}  # a free joint takes a list of columns" in text
