"""`idapt import`: every format becomes the same trajectory file, and a mistake is named where it is."""

import json

import numpy as np
import pytest
import yaml
from conftest import ROOT

from cli.import_ import import_recordings, read_layout
from cli.main import main
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from datamodules.recordings import (
    FORMATS,
    RecordingError,
    convert,
    fit_to_model,
    parse_mapping,
    read_mapping,
    read_recording,
)

MODEL = """
<mujoco>
  <worldbody>
    <body><joint name="slider" type="slide" axis="1 0 0" range="-1 1" limited="true"/><geom size="0.1"/>
      <body><joint name="hinge" type="hinge" axis="0 1 0" range="-90 90" limited="true"/><geom size="0.1"/></body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slider" ctrlrange="-3 3" ctrllimited="true"/><motor joint="hinge"/></actuator>
</mujoco>"""

MAP = {
    "time": {"column": "t", "unit": "s"},
    "joints": {"slider": {"position": "x", "velocity": "v"}, "hinge": {"position": "q", "velocity": "w"}},
    "actuators": {"push": "u", "hinge": "tau"},
}


def recorded(rows=21, dt=0.02):
    """Columns of a smooth motion."""
    t = dt * np.arange(rows)
    x, v, q, w = 0.5 * np.sin(3 * t), 1.5 * np.cos(3 * t), np.cos(2 * t) - 0.5, -2 * np.sin(2 * t)
    return {"t": t, "x": x, "v": v, "q": q, "w": w, "u": np.sin(t), "tau": 0.1 * np.arange(rows)}


def write_csv(path, columns, delimiter=",", before=""):
    rows = [delimiter.join(columns)] + [delimiter.join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text(before + "\n".join(rows) + "\n")
    return path


def changed(**entries):
    """The usual map with some entries of the top level replaced; None takes one out."""
    return {k: v for k, v in (MAP | entries).items() if v is not None}


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "nominal.xml"
    path.write_text(MODEL)
    return path


@pytest.fixture
def write_map(tmp_path):
    def write(content=MAP):
        path = tmp_path / "map.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False))
        return path

    return write


@pytest.fixture
def csv(tmp_path):
    return write_csv(tmp_path / "run.csv", recorded())


def load(path, mapping=MAP, format=None, model=None):
    """Trajectories of a recording, without the command line."""
    mapping, layout = parse_mapping(mapping), None
    if model is not None:
        layout = read_layout(model)
        mapping = fit_to_model(mapping, layout)
    return import_recordings([path], mapping, layout, format)


def assert_as_recorded(episode, columns=None):
    c = columns or recorded()
    np.testing.assert_allclose(episode.observations["qpos"], np.stack([c["x"], c["q"]], 1))
    np.testing.assert_allclose(episode.observations["qvel"], np.stack([c["v"], c["w"]], 1))
    np.testing.assert_allclose(episode.actions, np.stack([c["u"], c["tau"]], 1)[:-1], rtol=1e-6)


# --- every format, the same trajectory ------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_of_any_separator(delimiter, tmp_path):
    imported = load(write_csv(tmp_path / "run.csv", recorded(), delimiter))
    (episode,) = imported.trajectories
    assert_as_recorded(episode)
    assert imported.trajectories.dt == 0.02 and episode.timestamps is None and not imported.notes


def test_csv_with_lines_before_the_header_and_without_a_header(tmp_path):
    path = write_csv(tmp_path / "a.csv", recorded(), before="rig 3\nlogger 1.2, beta\n# ")
    assert_as_recorded(load(path, changed(skip_rows=2)).trajectories.episodes[0])
    bare = tmp_path / "b.csv"
    bare.write_text("\n".join(path.read_text().splitlines()[3:]))
    by_number = {
        **{"header": False, "time": {"column": 0}, "actuators": {"push": 5, "hinge": 6}},
        "joints": {"slider": {"position": 1, "velocity": 2}, "hinge": {"position": 3, "velocity": 4}},
    }
    assert_as_recorded(load(bare, by_number).trajectories.episodes[0])


def by_array(q="q", v="v", u="u", time="t"):
    """A map onto elements of arrays."""
    return {
        "time": {"column": time},
        "joints": {n: {"position": f"{q}[{i}]", "velocity": f"{v}[{i}]"} for i, n in enumerate(("slider", "hinge"))},
        "actuators": {n: f"{u}[{i}]" for i, n in enumerate(("push", "hinge"))},
    }


def arrays(rows=21):
    c = recorded(rows)
    pair = lambda a, b: np.stack([c[a], c[b]], 1)  # noqa: E731
    return {"q": pair("x", "q"), "v": pair("v", "w"), "u": pair("u", "tau"), "t": c["t"]}


@pytest.mark.parametrize("short", [False, True], ids=["actions of T+1 rows", "actions of T rows"])
def test_npz(short, tmp_path):
    a = arrays()
    extra = {"notes": np.array({"rig": 3}), "video": np.zeros((21, 4, 4, 3), np.uint8)}
    np.savez(tmp_path / "run.npz", **a | extra | ({"u": a["u"][:-1]} if short else {}))
    assert_as_recorded(load(tmp_path / "run.npz", by_array()).trajectories.episodes[0])


def test_minari_hdf5_dataset_by_folder_and_by_id(tmp_path, monkeypatch):
    a = arrays()
    folder = tmp_path / "robot" / "arm-v0"
    observations = {"qpos": a["q"], "qvel": a["v"]}
    episodes = tuple(Episode(a["u"][:-1].astype(np.float32), observations) for _ in range(11))
    write_trajectories(folder / "data" / "main_data.hdf5", Trajectories(episodes, 0.02))
    mapping = by_array("observations/qpos", "observations/qvel", "actions") | {"dt": 0.02}
    del mapping["time"]
    imported = load(folder, mapping)
    assert len(imported.trajectories) == 11
    assert_as_recorded(imported.trajectories.episodes[10])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert len(load("robot/arm-v0", mapping).trajectories) == 11


@pytest.mark.parametrize("data_format", ["hdf5", "arrow"])
def test_minari_dataset_that_minari_itself_wrote(data_format, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    if data_format == "arrow":
        pytest.importorskip("pyarrow")
    gym = pytest.importorskip("gymnasium")
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    a, T = arrays(), 20
    buffer = EpisodeBuffer(
        id=0, observations=np.concatenate([a["q"], a["v"]], 1), actions=a["u"][:-1], rewards=np.zeros(T),
        terminations=np.zeros(T, bool), truncations=np.arange(T) == T - 1,
    )  # fmt: skip
    box = lambda n: gym.spaces.Box(-9, 9, (n,), np.float64)  # noqa: E731
    with pytest.warns(UserWarning):  # that author and code link are missing
        minari.create_dataset_from_buffers(
            "robot/arm-v0", [buffer], observation_space=box(4), action_space=box(2), data_format=data_format
        )
    mapping = {
        "dt": 0.02,
        "joints": {
            n: {"position": f"observations[{i}]", "velocity": f"observations[{i + 2}]"}
            for i, n in enumerate(("slider", "hinge"))
        },
        "actuators": {"push": "actions[0]", "hinge": "actions[1]"},
    }
    assert_as_recorded(load("robot/arm-v0", mapping).trajectories.episodes[0])


@pytest.mark.parametrize("layout", ["v2", "v3"])
def test_lerobot_dataset(layout, tmp_path):
    """v2 has one file an episode, v3 several episodes in one."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    a, folder = arrays(), tmp_path / "pick"
    episode = {
        "observation.state": np.concatenate([a["q"], a["v"]], 1).tolist(),
        "action": a["u"].tolist(),
        "timestamp": a["t"],
        "front": [{"bytes": b"", "path": "0.png"}] * 21,
    }
    tables = [pyarrow.table(episode | {"episode_index": [i] * 21}) for i in range(2)]
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if layout == "v2":
        for i, table in enumerate(tables):
            parquet.write_table(table, data / f"episode_{i:06}.parquet")
    else:
        parquet.write_table(pyarrow.concat_tables(tables), data / "file-000.parquet")
    (folder / "meta").mkdir()
    names = ["slider.pos", "hinge.pos", "slider.vel", "hinge.vel"]
    features = {"observation.state": {"names": names}, "action": {"names": {"motors": ["push", "hinge"]}}}
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": 50, "features": features}))
    mapping = {
        "time": {"column": "timestamp"},
        "joints": {
            n: {"position": f"observation.state[{n}.pos]", "velocity": f"observation.state[{i + 2}]"}
            for i, n in enumerate(("slider", "hinge"))
        },
        "actuators": {n: f"action[{n}]" for n in ("push", "hinge")},
    }
    imported = load(folder, mapping)
    assert len(imported.trajectories) == 2 and imported.trajectories.dt == 0.02
    for e in imported.trajectories:
        assert_as_recorded(e)


START = 1_700_000_000_000_000_000
"""ns, a log time of our days: too large for float64 to hold to the ns."""

MCAP_MAP = {
    "time": {"column": "/joint_states.header.stamp", "unit": "ns"},
    "joints": {
        n: {"position": f"/joint_states.position[{n}]", "velocity": f"/joint_states.velocity[{n}]"}
        for n in ("slider", "hinge")
    },
    "actuators": {"push": "/command.data[0]", "hinge": "/command.data[1]"},
}


def messages(rows=21):
    """Topic, log time and content; states name their joints in changing order, commands lie 5 ms before them."""
    c = recorded(rows)
    for k in range(rows):
        ns = START + round(c["t"][k] * 1e9)
        yield "/command", ns - 5_000_000, {"data": [c["u"][k], c["tau"][k]]}
        names = ["slider", "hinge"] if k % 2 else ["hinge", "slider"]
        value = {"slider": (c["x"][k], c["v"][k]), "hinge": (c["q"][k], c["w"][k])}
        stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
        state = {"header": {"stamp": stamp}, "name": names}
        state |= {"position": [value[n][0] for n in names], "velocity": [value[n][1] for n in names]}
        yield "/joint_states", ns, state


def write_json_mcap(path, encoding="json", rows=21):
    from mcap.writer import Writer

    with path.open("wb") as f:
        writer = Writer(f)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, encoding, schema) for t in ("/joint_states", "/command", "/camera")}
        for topic, ns, content in messages(rows):
            writer.add_message(channels[topic], ns, json.dumps(content).encode(), ns)
        writer.add_message(channels["/camera"], START, b"no JSON, and not asked for", START)
        writer.finish()
    return path


def test_mcap_of_json_messages(tmp_path):
    pytest.importorskip("mcap")
    imported = load(write_json_mcap(tmp_path / "run.mcap"), MCAP_MAP)
    assert_as_recorded(imported.trajectories.episodes[0])
    assert imported.trajectories.dt == 0.02 and imported.timing.regular


def test_mcap_rows_are_messages_of_the_clock_and_the_rest_is_held(tmp_path):
    pytest.importorskip("mcap")
    path = write_json_mcap(tmp_path / "run.mcap")
    clocked = MCAP_MAP | {"clock": "/command", "time": {"column": "/command.log_time", "unit": "ns"}}
    (episode,) = load(path, clocked).trajectories
    c = recorded()
    np.testing.assert_allclose(episode.observations["qpos"][:, 0], c["x"][:-1])  # the first command saw no state yet
    np.testing.assert_allclose(episode.actions[:, 1], c["tau"][1:-1], rtol=1e-6)


def test_mcap_of_ros2_messages(tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap_ros2.writer import Writer

    state = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n" + "=" * 80
    state += "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
    state += "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    with (tmp_path / "run.mcap").open("wb") as f:
        writer = Writer(f)
        schemas = {
            "/joint_states": writer.register_msgdef("sensor_msgs/msg/JointState", state),
            "/command": writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data\n"),
        }
        for topic, ns, content in messages():
            if "header" in content:
                content["header"]["frame_id"] = "base"
            writer.write_message(topic, schemas[topic], content, log_time=ns, publish_time=ns)
        writer.finish()
    assert_as_recorded(load(tmp_path / "run.mcap", MCAP_MAP).trajectories.episodes[0])


def test_mcap_of_protobuf_messages(tmp_path):
    pytest.importorskip("mcap_protobuf")
    from google.protobuf.struct_pb2 import Struct
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap_protobuf.writer import Writer

    with (tmp_path / "run.mcap").open("wb") as f:
        writer = Writer(f)
        for k in range(5):
            ns = START + 20_000_000 * k
            writer.write_message("/t", Timestamp(seconds=ns // 10**9, nanos=ns % 10**9), ns, ns)
            writer.write_message("/s", Struct(), ns, ns)
        writer.finish()
    mapping = {
        "time": {"column": "/t.log_time", "unit": "ns"},
        "joints": {"a": {"position": {"column": "/t.log_time", "scale": 0}}},
    }
    assert load(tmp_path / "run.mcap", mapping).trajectories.dt == 0.02


# --- units, sign, offset, order, time -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"unit": "deg"}, np.deg2rad(100)),
        ({"unit": "rev"}, 200 * np.pi),
        ({"unit": "counts:400"}, np.pi / 2),
        ({"unit": "counts:400", "sign": -1, "offset": 1.5}, 1.5 - np.pi / 2),
        ({"unit": "mm", "offset": -0.05}, 0.05),
        ({"scale": 2.33625, "offset": -0.174533}, 233.625 - 0.174533),
        ({"unit": "rad", "scale": "1e-3", "sign": -1}, -0.1),
        ({"constant": 0.3}, 0.3),
    ],
)
def test_position_becomes_the_models_unit_then_sign_then_offset(entry, expected, tmp_path):
    path = write_csv(tmp_path / "a.csv", {"q": [100, 100, 100]})
    entry = entry if "constant" in entry else {"column": "q"} | entry
    joints = {"b": {"position": "q"}, "a": {"position": entry}}
    (episode,) = load(path, {"dt": 0.1, "joints": joints}).trajectories
    np.testing.assert_allclose(episode.observations["qpos"], [[100, expected]] * 3)


def test_units_of_velocities_and_commands(tmp_path):
    path = write_csv(tmp_path / "a.csv", {"q": [0, 0], "w": [60, 60], "u": [500, 500]})
    for unit, expected in {"rpm": 2 * np.pi, "deg/s": np.pi / 3, "counts:60/s": 2 * np.pi, "deg": np.pi / 3}.items():
        joint = {"position": {"column": "q", "unit": "deg"}, "velocity": {"column": "w", "unit": unit}}
        (episode,) = load(path, {"dt": 0.1, "joints": {"a": joint}}).trajectories
        np.testing.assert_allclose(episode.observations["qvel"], expected)
    for unit, expected in {"mNm": 0.5, "%": 5, "mV": 0.5, "deg": np.deg2rad(500), "N m": 500}.items():
        actuators = {"m": {"column": "u", "unit": unit, "sign": -1}}
        mapping = {"dt": 0.1, "joints": {"a": {"position": "q"}}, "actuators": actuators}
        np.testing.assert_allclose(load(path, mapping).trajectories.episodes[0].actions, -expected, rtol=1e-6)


def test_joints_and_actuators_are_put_in_the_models_order(csv, model):
    """The second motor has no name of its own and goes by its joint's."""
    turned = {**MAP, **{k: dict(reversed(MAP[k].items())) for k in ("joints", "actuators")}}
    swapped = load(csv, turned).trajectories.episodes[0].observations["qpos"]
    np.testing.assert_allclose(swapped[:, 0], recorded()["q"])
    assert_as_recorded(load(csv, turned, model=model).trajectories.episodes[0])


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_time_units_and_absolute_times(unit, tmp_path):
    scale = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    t = (1_700_000_000 * scale + np.round(recorded()["t"] * scale).astype(np.int64)) if scale > 1 else recorded()["t"]
    np.savez(tmp_path / "a.npz", **recorded() | {"t": t})
    fine = load(tmp_path / "a.npz", changed(time={"column": "t", "unit": unit}))
    assert fine.trajectories.dt == pytest.approx(0.02, rel=1e-9)


@pytest.mark.parametrize("period", [0.001, 0.005, 1 / 1024])
@pytest.mark.parametrize("unit", ["s", "ns"])
def test_a_clock_of_our_days_is_as_regular_as_its_rows(unit, period, tmp_path):
    c = recorded(20_001, period)
    ns = 1_732_701_000_001_000_000 + np.round(c["t"] * 1e9).astype(np.int64)
    stamps = ns if unit == "ns" else [f"{k // 10**9}.{k % 10**9:09d}" for k in ns.tolist()]
    imported = load(write_csv(tmp_path / "a.csv", c | {"t": stamps}), changed(time={"column": "t", "unit": unit}))
    assert imported.timing.regular and imported.trajectories.dt == period


def test_a_period_that_is_no_round_number_is_not_rounded(tmp_path):
    path = write_csv(tmp_path / "a.csv", recorded(2001, 0.0010000002))
    assert load(path).trajectories.dt == pytest.approx(0.0010000002, rel=1e-12)


def test_timestamps_are_kept_only_where_sampling_is_irregular(tmp_path):
    for jitter, regular in ((0.005, True), (0.05, False)):
        c = recorded()
        c["t"] = c["t"] + 7 + np.where(np.arange(21) == 10, jitter * 0.02, 0)
        imported = load(write_csv(tmp_path / "a.csv", c))
        (episode,) = imported.trajectories
        assert imported.timing.regular == regular == (episode.timestamps is None)
        assert imported.trajectories.dt == pytest.approx(0.02) and imported.timing.jitter == pytest.approx(jitter)
    np.testing.assert_allclose(episode.timestamps, c["t"] - 7)


def test_a_period_that_drifts_is_irregular(tmp_path):
    c = recorded(400)
    c["t"] = np.cumsum(np.where(np.arange(400) < 210, 0.02, 0.02018))
    assert not load(write_csv(tmp_path / "a.csv", c)).timing.regular


def test_actions_at_end_belong_to_the_step_that_led_to_the_row(csv):
    (episode,) = load(csv, changed(actions_at="end")).trajectories
    np.testing.assert_allclose(episode.actions[:, 1], recorded()["tau"][1:], rtol=1e-6)


def test_episodes_are_told_apart_by_a_column_or_by_file(tmp_path, csv):
    c = recorded()
    two = {k: np.concatenate([v, v[:11]]) for k, v in c.items()} | {"run": ["b"] * 21 + ["a"] * 11}
    imported = load(write_csv(tmp_path / "two.csv", two), changed(episodes={"column": "run"}))
    assert [len(e) for e in imported.trajectories] == [20, 10]
    assert_as_recorded(imported.trajectories.episodes[1], {k: v[:11] for k, v in c.items()})
    assert len(import_recordings([csv, csv, csv], parse_mapping(MAP)).trajectories) == 3


def test_passive_recording_has_actions_of_no_columns(csv, tmp_path):
    trajectories = load(csv, changed(actuators=None)).trajectories
    write_trajectories(tmp_path / "d.h5", trajectories)
    (episode,) = read_trajectories(tmp_path / "d.h5")
    assert episode.actions.shape == (20, 0) and len(episode) == 20


def test_infos_are_kept_as_they_are(tmp_path):
    c = recorded() | {"amps": np.arange(21) - 0.5, "state": ["grün"] * 21}
    trajectories = load(
        write_csv(tmp_path / "a.csv", c), changed(infos={"current": "amps", "mode": "state"})
    ).trajectories
    write_trajectories(tmp_path / "d.h5", trajectories)
    infos = read_trajectories(tmp_path / "d.h5").episodes[0].infos
    np.testing.assert_array_equal(infos["current"], c["amps"])
    assert infos["mode"][0].decode() == "grün"


def test_velocities_are_left_out_unless_every_joint_has_one(csv):
    joints = {"slider": {"position": "x", "velocity": "v"}, "hinge": {"position": "q"}}
    imported = load(csv, changed(joints=joints))
    assert set(imported.trajectories.episodes[0].observations) == {"qpos"}
    assert "hinge has no velocity" in imported.notes[0]


def test_free_joint_takes_seven_columns(tmp_path):
    (tmp_path / "free.xml").write_text(
        '<mujoco><worldbody><body><freejoint name="root"/><geom size="1"/></body></worldbody></mujoco>'
    )
    row = [0.0, 1.0, 2.0, 0.1, 0.3, 0.5, 0.806]
    path = write_csv(tmp_path / "a.csv", {k: [value] * 3 for k, value in zip("abcdefg", row, strict=True)})
    mapping = {"dt": 0.1, "joints": {"root": {"position": {"column": list("abcdefg")}}}}
    imported = load(path, mapping, model=tmp_path / "free.xml")
    np.testing.assert_array_equal(imported.trajectories.episodes[0].observations["qpos"][0], row)
    with pytest.raises(RecordingError, match="a free joint takes 7 columns, got 1"):
        load(path, {"dt": 0.1, "joints": {"root": {"position": "a"}}}, model=tmp_path / "free.xml")


# --- mistakes in the map --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(tiem={"column": "t"}), r"unknown key 'tiem'; did you mean 'time'\? keys are: time, dt, joints"),
        (changed(time={"column": "t", "units": "s"}), "time: unknown key 'units'; did you mean 'unit'"),
        (changed(time={"column": "t", "unit": "sec"}), "time.unit: expected s or ms or us or ns, got 'sec'"),
        (changed(dt=0.02), "either time, .* or dt: <seconds>; it has both"),
        (changed(time=None), "it has neither"),
        (changed(time=None, dt=0), "dt: expected a period of 1e-06 to 100 seconds, got 0"),
        (changed(time=None, dt="fast"), "dt: expected a number, got 'fast'"),
        (changed(joints=None), "joints: expected at least one joint with a position column"),
        (changed(joints={"a": {"velocity": "v"}}), "joints.a: position is missing"),
        (changed(joints={"a": "x"}), "joints.a: expected keys among position, velocity, axes; got 'x'"),
        (changed(joints={"a": {"position": {"unit": "deg"}}}), "joints.a.position.column: expected the name of a col"),
        (changed(joints={"a": {"position": {"column": "x", "unit": "degrees"}}}), "unknown unit 'degrees'; did you"),
        (changed(joints={"a": {"position": {"column": "x", "unit": "counts:0"}}}), "counts:<counts per revolution>"),
        (changed(joints={"a": {"position": {"column": "x", "sign": 2}}}), "sign: expected 1 or -1, got 2"),
        (changed(joints={"a": {"position": {"column": "x", "offset": "no"}}}), "offset: expected a number, got 'no'"),
        (changed(joints={"a": {"position": {"column": "x", "constant": 1}}}), "constant stands alone"),
        (
            changed(joints={"a": {k: {"column": k, "unit": u} for k, u in (("position", "mm"), ("velocity", "rpm"))}}),
            "position is in mm and the velocity in rpm",
        ),
        (changed(actuators={"push": {"column": "u", "unit": "horses"}}), "unknown unit 'horses' .*scale.* are: N,"),
        (changed(actuators={True: "u"}), "actuators: expected a name, got True; .*quotes"),
        (changed(actuators=["u"]), "actuators: expected one entry a name, got"),
        (changed(actions_at="middle"), "actions_at: expected start or end, got 'middle'"),
        (changed(skip_rows=-1), "skip_rows: expected a whole number"),
        (changed(delimiter="||"), "delimiter: expected one character"),
        (changed(episodes="run"), "episodes: expected keys among column; got 'run'"),
        ("joints: [", "not valid YAML"),
        ("dt: 1\njoints: {a: {position: x}, a: {position: y}}", "key 'a' stands twice"),
        ("", "the map: expected keys among"),
        ("dt: !!python/object/apply:os.getcwd []", "not valid YAML"),
    ],
)  # fmt: skip
def test_mistake_in_the_map_is_named_by_file_and_key(content, message, write_map):
    with pytest.raises(RecordingError, match=rf"map\.yaml: .*{message}"):
        read_mapping(write_map(content))


def test_maps_of_the_documentation_are_read(write_map):
    blocks = (ROOT / "docs" / "guide" / "import.md").read_text().split("```yaml\n")[1:]
    mappings = [read_mapping(write_map(block.partition("```")[0])) for block in blocks]
    assert len(mappings) >= 4 and all(m.joints or m.images for m in mappings)


# --- mistakes in the recording --------------------------------------------------------------------------


def with_cell(column, row, value):
    """A recording with one cell changed; row 0 is in line 2."""
    c = {k: list(v) for k, v in recorded().items()}
    c[column][row] = value
    return c


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({k: v for k, v in recorded().items() if k != "tau"}, r"no column 'tau', .*actuators\.hinge; columns are: t,"),
        (with_cell("q", 4, "nan"), r"column 'q', line 6: expected a number, got nan or nothing \(1 such rows\)"),
        (with_cell("q", 4, ""), "column 'q', line 6: expected a number, got nan or nothing"),
        (with_cell("u", 4, "inf"), "column 'u', line 6: expected a number, got inf"),
        (with_cell("x", 7, "n/a"), "column 'x', line 9: expected a number, got 'n/a'"),
        (with_cell("t", 3, 0.039), r"time column 't', line 5: time goes back from 0\.04 to 0\.039"),
        (with_cell("t", 3, 0.04), r"time column 't', line 5: time stands still at 0\.04"),
        (with_cell("t", 3, "noon"), "column 't', line 5: expected a number, got 'noon'"),
        ({k: v[:1] for k, v in recorded().items()}, "has 1 rows, expected at least 2"),
        ({k: [] for k in recorded()}, "has a header but no rows"),
    ],
)  # fmt: skip
def test_mistake_in_a_recording_is_named_by_file_column_and_line(columns, message, tmp_path):
    with pytest.raises(RecordingError, match=rf"bad\.csv: .*{message}"):
        load(write_csv(tmp_path / "bad.csv", columns))


def test_last_command_may_be_missing(tmp_path):
    assert_as_recorded(load(write_csv(tmp_path / "a.csv", with_cell("u", 20, ""))).trajectories.episodes[0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("bad.csv", b"", "is empty; expected a header and rows"),
        ("bad.csv", b"t,x,v,q,w,u,tau\n0,1,2\n", "line 2 has 3 cells, expected 7"),
        ("bad.csv", b"0,1,2\n3,4,5\n", "expected column names, got numbers .*header: false"),
        ("bad.csv", b"t;x;x\n0;1;2\n3;4;5\n", "column 'x' stands twice"),
        ("bad.csv", b"t;x;v;q;w;u;tau\n0;0,5;0;0;0;0;0\n1;0,5;0;0;0;0;0\n", "'0,5'; write decimals with"),
        ("bad.csv", b"\xff\xfe\x00\x01", "not a text table"),
        ("bad.npz", b"PK nothing", "not a readable NPZ"),
        ("bad.hdf5", b"nothing", "not a readable HDF5"),
        ("bad.dat", b"", r"does not tell its format; say --format csv\|npz"),
    ],
)  # fmt: skip
def test_file_that_is_not_what_its_name_says_is_named(name, content, message, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=rf"{name}: .*{message}"):
        load(tmp_path / name)


@pytest.mark.parametrize(("name", "package"), [("bad.mcap", "mcap"), ("bad.parquet", "pyarrow")])
def test_broken_file_of_an_optional_format_is_named(name, package, tmp_path):
    pytest.importorskip(package)
    (tmp_path / name).write_bytes(b"nothing of the kind")
    with pytest.raises(RecordingError, match=f"{name}: not a readable"):
        load(tmp_path / name)


@pytest.mark.parametrize("name", ["run.parquet", "run.mcap"])
def test_missing_optional_package_names_the_pip_command(name, tmp_path, monkeypatch):
    import sys

    for module in ("pyarrow", "pyarrow.parquet", "mcap"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).touch()
    with pytest.raises(RecordingError, match=rf'{name}: .* is not installed; pip install "idapt\[import\]"'):
        load(tmp_path / name)


def test_mcap_mistakes_name_topic_and_encoding(tmp_path):
    pytest.importorskip("mcap")
    path = write_json_mcap(tmp_path / "run.mcap", rows=3)
    other = json.loads(json.dumps(MCAP_MAP).replace("/command", "/commands"))
    with pytest.raises(RecordingError, match=r"of no topic in it; .*topics are: /camera, /command, /joint_states"):
        load(path, other)
    with pytest.raises(RecordingError, match=r"no column '/joint_states.effort\[0\]'.*columns are: "):
        load(path, MCAP_MAP | {"joints": {"a": {"position": "/joint_states.effort[0]"}, **MCAP_MAP["joints"]}})
    with pytest.raises(RecordingError, match=r"/camera at log time .* cannot be decoded as json"):
        load(path, MCAP_MAP | {"infos": {"image": "/camera.data"}})
    with pytest.raises(RecordingError, match=r"encoded as 'flatbuffer', for which no decoder is installed"):
        load(write_json_mcap(tmp_path / "other.mcap", "flatbuffer"), MCAP_MAP)


def test_arrays_of_different_lengths_are_an_error(tmp_path):
    np.savez(tmp_path / "run.npz", **arrays() | {"v": arrays()["v"][:15]})
    with pytest.raises(RecordingError, match=r"column 'v\[0\]' has 15 rows, expected 21"):
        load(tmp_path / "run.npz", by_array())


def test_missing_recording_and_unknown_folder_are_named(tmp_path):
    with pytest.raises(RecordingError, match="no such file or folder"):
        load(tmp_path / "nothing.csv")
    with pytest.raises(RecordingError, match=r"no LeRobot dataset .* nor Minari dataset"):
        load(tmp_path)
    with pytest.raises(RecordingError, match="minari download robot/nothing-v3"):
        load("robot/nothing-v3")


# --- against a model ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(joints={"hing": {"position": "q"}, "slider": {"position": "x"}}),
         r"joints\.hing: .*nominal\.xml has no such joint; did you mean 'hinge'\? its joints are: slider, hinge"),
        (changed(joints={"hinge": {"position": "q"}}), r"joints: slider of .*xml is not mapped.*constant: 0"),
        (changed(actuators={"push": "u", "twist": "tau"}), r"actuators\.twist: .*its actuators are: push, hinge"),
        (changed(actuators=None), "actuators: push, hinge of .* is not mapped; .*a model without actuators"),
        (changed(joints={"slider": {"position": {"column": "x", "unit": "deg"}}, "hinge": {"position": "q"}}),
         "joint slider is a slide joint, in m; got unit deg"),
    ],
)  # fmt: skip
def test_map_that_does_not_fit_the_model_is_an_error_with_its_names(content, message, csv, model):
    with pytest.raises(RecordingError, match=message):
        load(csv, content, model=model)


@pytest.mark.parametrize(("joint", "unit"), [("hinge", "unit: deg"), ("slider", "unit: mm")])
def test_joint_that_moves_far_beyond_its_range_raises_the_question_of_units(joint, unit, csv, model):
    column = {"hinge": "q", "slider": "x"}[joint]
    joints = MAP["joints"] | {joint: {"position": {"column": column, "scale": 1000}}}
    with pytest.raises(RecordingError, match=rf"joint {joint} moves over .* 10 times its range .*{unit}"):
        load(csv, changed(joints=joints), model=model)


def doubts(csv, model, **entries):
    return " ".join(load(csv, changed(**entries), model=model).notes)


def test_doubts_about_offset_sign_velocity_and_command_are_noted(csv, model):
    joints = MAP["joints"]
    assert doubts(csv, model) == ""
    shifted = joints | {"slider": {"position": {"column": "x", "offset": 5}}}
    assert "beyond its range" in doubts(csv, model, joints=shifted)
    degrees = joints | {"hinge": {"position": {"column": "q", "unit": "rad", "scale": 57.3}}}
    assert "are the units degrees" in doubts(csv, model, joints=degrees)
    turned = joints | {"slider": {"position": "x", "velocity": {"column": "v", "sign": -1}}}
    assert "joint slider: the velocity has the opposite sign" in doubts(csv, model, joints=turned)
    wrong = joints | {"hinge": {"position": "q", "velocity": {"column": "w", "unit": "deg/s"}}}
    assert "joint hinge: the velocity is 0.0175 times the position's slope" in doubts(csv, model, joints=wrong)
    strong = {"push": {"column": "u", "scale": 100}, "hinge": "tau"}
    assert "beyond its control range -3 to 3" in doubts(csv, model, actuators=strong)


def test_unlimited_hinge_in_degrees_and_a_pause_are_noted(tmp_path):
    (tmp_path / "wheel.xml").write_text(
        '<mujoco><worldbody><body><joint name="w"/><geom size="1"/></body></worldbody></mujoco>'
    )
    path = write_csv(tmp_path / "a.csv", {"t": [0, 1, 2, 3, 20, 21], "q": [0, 90, 180, 270, 360, 360]})
    content = {"time": "t", "joints": {"w": {"position": "q"}}}
    notes = load(path, content, model=tmp_path / "wheel.xml").notes
    assert any("are the units degrees" in note for note in notes)
    assert any("the longest 17 s after" in note and "line 5" in note for note in notes)


def test_long_pauses_end_episodes_and_are_told_of(tmp_path):
    t = np.concatenate([np.arange(10) * 0.1, 1000 + np.arange(5) * 0.1, [5000], 6000 + np.arange(3) * 0.1])
    path = write_csv(tmp_path / "a.csv", {"t": t, "q": np.arange(19), "u": np.arange(19)})
    content = {"time": "t", "joints": {"w": {"position": "q"}}, "actuators": {"m": "u"}}
    imported = load(path, content)
    assert [len(e) for e in imported.trajectories] == [9, 4, 2]
    assert imported.trajectories.dt == pytest.approx(0.1) and imported.timing.regular
    first = [e.observations["qpos"][0, 0] for e in imported.trajectories]
    assert first == [0, 10, 16] and imported.trajectories.episodes[1].actions[:, 0].tolist() == [10, 11, 12, 13]
    (note,) = imported.notes
    assert note.startswith("3 pauses of more than 1 s, the longest 4e+03 s after") and "line 16" in note
    assert note.endswith("into 3 episodes (1 single rows are left out)")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": {"w": {"position": {"column": "q", "scale": 1e300}}}}, "joints.w.position: 1e\\+10 of column 'q'"),
        ({"actuators": {"m": {"column": "u", "scale": 1e38}}}, "actuators.m: 11 of column 'u' becomes 1.1e\\+39"),
        ({"infos": {"a/b": "u"}}, "infos: a name goes into the file as it is, without slashes; got 'a/b'"),
        ({"time": {"column": "t", "unit": "ns"}}, "is the unit of time right"),
    ],
)
def test_what_no_file_can_hold_is_refused(changes, message, tmp_path):
    path = write_csv(tmp_path / "a.csv", {"t": [0, 1, 2], "q": [0, 1, 1e10], "u": [1, 11, 1]})
    with pytest.raises(RecordingError, match=message):
        load(path, {"time": "t", "joints": {"w": {"position": "q"}}} | changes)


def test_more_skipped_rows_than_there_are_end_at_once(tmp_path):
    path = write_csv(tmp_path / "a.csv", {"t": [0, 1, 2], "q": [0, 1, 2]})
    with pytest.raises(RecordingError, match="is empty after the 1000000000000 skipped rows"):
        load(path, {"time": "t", "skip_rows": 10**12, "joints": {"w": {"position": "q"}}})


# --- the command ----------------------------------------------------------------------------------------


def run(args, capsys):
    """Exit code and what was printed."""
    try:
        code = main([str(a) for a in args])
    except SystemExit as end:  # argparse leaves this way
        code = end.code
    printed = capsys.readouterr()
    assert "Traceback" not in printed.out + printed.err
    return code, printed


def test_import_writes_the_file_and_shows_what_was_understood(csv, write_map, model, tmp_path, capsys):
    out = tmp_path / "measured.h5"
    code, printed = run(["import", csv, "--map", write_map(), "--model", model, "--out", out], capsys)
    assert code == 0
    for words in ("slider position", "hinge velocity", "push command", "rad/s", "episodes 1, steps 20", "jitter 0.00%"):
        assert words in printed.out
    trajectories = read_trajectories(out)
    assert trajectories.dt == 0.02 and "run.csv" in trajectories.source
    assert_as_recorded(trajectories.episodes[0])
    again = tmp_path / "again.h5"  # a trajectory file is a recording like any other
    by_element = by_array("observations/qpos", "observations/qvel", "actions") | {"dt": 0.02}
    del by_element["time"]
    assert run(["import", out, "--map", write_map(by_element), "--out", again], capsys)[0] == 0
    assert_as_recorded(read_trajectories(again).episodes[0])


def test_dry_run_shows_the_same_and_writes_nothing(csv, write_map, tmp_path, capsys):
    arguments = ["import", csv, "--map", write_map(), "--dry-run"]
    before = sorted(tmp_path.iterdir())
    for more in ([], ["--out", tmp_path / "measured.h5"]):
        code, printed = run([*arguments, *more], capsys)
        assert code == 0 and "steps 20" in printed.out and "nothing was written" in printed.out
        assert sorted(tmp_path.iterdir()) == before


def test_bad_usage_is_2_and_a_mistake_in_the_data_1(csv, write_map, tmp_path, capsys):
    out = ["--out", tmp_path / "d.h5"]
    assert run(["import", csv, *out], capsys)[0] == 2
    assert run(["import", csv, "--map", write_map()], capsys)[0] == 2
    assert run(["import", csv, "--map", write_map(), *out, "--format", "xls"], capsys)[0] == 2
    code, printed = run(["import", csv, "--map", tmp_path / "none.yaml", *out], capsys)
    assert code == 1 and "none.yaml: no such file" in printed.err
    code, printed = run(["import", csv, "--map", write_map(), "--out", csv], capsys)
    assert code == 1 and "also read from" in printed.err
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>")
    code, printed = run(["import", csv, "--map", write_map(), *out, "--model", broken], capsys)
    assert code == 1 and "broken.xml: MuJoCo cannot read the model" in printed.err
    assert not (tmp_path / "d.h5").exists()


def test_every_format_has_a_reader_that_names_its_episodes(csv):
    assert set(FORMATS) == {"csv", "npz", "minari", "lerobot", "mcap", "rosbag1", "rosbag2", "ulog", "jsonl"}
    mapping = parse_mapping(MAP)
    (episode,) = read_recording(csv, mapping)
    assert str(csv) in episode.source and convert([episode], mapping).trajectories.total_steps == 20
