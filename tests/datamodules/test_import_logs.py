"""Bags of ROS 2, ULog files and JSON lines: written small and whole here, read without ROS, damaged in every way."""

import json
import sqlite3
import struct

import numpy as np
import pytest
import yaml
from test_import import MAP, MCAP_MAP, START, assert_as_recorded, load, messages, recorded, write_json_mcap

from datamodules.recordings import RecordingError
from datamodules.recordings.messages import flatten

# --- rosbag2 --------------------------------------------------------------------------------------------

JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
JOINT_STATE += "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
ARRAY = "std_msgs/MultiArrayLayout layout\nfloat64[] data\n" + "=" * 80 + "\nMSG: std_msgs/MultiArrayLayout\n"
ARRAY += "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n" + "=" * 80
ARRAY += "\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n"
TYPES = {
    "/joint_states": ("sensor_msgs/msg/JointState", JOINT_STATE),
    "/command": ("std_msgs/msg/Float64MultiArray", ARRAY),
}
BAG_MAP = MCAP_MAP


def serialised(topic, content):
    """A message in CDR, by the rules of its wire format: little endian, numbers aligned to their size."""
    out = bytearray()

    def put(kind, value):
        size = struct.calcsize(kind)
        out.extend(b"\0" * (-len(out) % size) + struct.pack(f"<{kind}", value))

    def text(value):
        put("I", len(value) + 1)
        out.extend(value.encode() + b"\0")

    def numbers(values):
        put("I", len(values))
        for value in values:
            put("d", value)

    if topic == "/command":
        put("I", 0)  # no dimensions
        put("I", 0)
        numbers(content["data"])
    else:
        stamp = content["header"]["stamp"]
        put("i", stamp["sec"])
        put("I", stamp["nanosec"])
        text("base")
        put("I", len(content["name"]))
        for name in content["name"]:
            text(name)
        for values in (content["position"], content["velocity"], []):
            numbers(values)
    return b"\0\1\0\0" + bytes(out)


def write_db3(path, rows=21, definitions=True, sent=None):
    """A bag's SQLite file; without definitions as Humble writes it."""
    bag = sqlite3.connect(path)
    bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
    bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    if definitions:
        bag.execute("CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, encoded_message_definition TEXT)")
    for number, (topic, (kind, text)) in enumerate(TYPES.items()):
        bag.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", (number, topic, kind))
        if definitions:
            bag.execute("INSERT INTO message_definitions VALUES (?, 'ros2msg', ?)", (kind, text))
    for topic, ns, content in sent or messages(rows):
        data = (list(TYPES).index(topic), ns, serialised(topic, content))
        bag.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", data)
    bag.commit()
    bag.close()
    return path


def change(path, *statements):
    """The bag after some SQL."""
    bag = sqlite3.connect(path)
    for statement in statements:
        bag.execute(statement)
    bag.commit()
    bag.close()
    return path


def write_metadata(folder, files, **more):
    info = {"version": 5, "storage_identifier": "sqlite3", "relative_file_paths": files} | more
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": info}))
    return folder


@pytest.mark.parametrize("definitions", [True, False], ids=["as Iron writes it", "as Humble writes it"])
def test_a_bag_is_what_was_sent(definitions, tmp_path):
    pytest.importorskip("mcap_ros2")
    if not definitions:
        pytest.importorskip("rosbags")
    imported = load(write_db3(tmp_path / "run_0.db3", definitions=definitions), BAG_MAP)
    assert_as_recorded(imported.trajectories.episodes[0])
    assert imported.trajectories.dt == 0.02 and imported.timing.regular


@pytest.mark.parametrize("distribution", ["ROS2_HUMBLE", "ROS2_JAZZY"])
def test_a_bag_that_rosbags_wrote_is_read(distribution, tmp_path):
    rosbag2, typesys = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
    pytest.importorskip("mcap_ros2")
    types = typesys.get_typestore(typesys.Stores[distribution])
    t = types.types
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        ends = {topic: writer.add_connection(topic, kind, typestore=types) for topic, (kind, _) in TYPES.items()}
        for topic, ns, content in messages():
            if topic == "/command":
                layout = t["std_msgs/msg/MultiArrayLayout"]([], 0)
                message = t["std_msgs/msg/Float64MultiArray"](layout, np.array(content["data"]))
            else:
                stamp = t["builtin_interfaces/msg/Time"](*content["header"]["stamp"].values())
                values = (np.array(content[k]) for k in ("position", "velocity"))
                header = t["std_msgs/msg/Header"](stamp, "base")
                message = t["sensor_msgs/msg/JointState"](header, content["name"], *values, np.zeros(0))
            writer.write(ends[topic], ns, types.serialize_cdr(message, ends[topic].msgtype))
    assert_as_recorded(load(tmp_path / "bag", BAG_MAP).trajectories.episodes[0])


def test_a_bag_in_several_files_is_one_episode(tmp_path):
    pytest.importorskip("mcap_ros2")
    sent = list(messages())
    for i, part in enumerate((sent[:20], sent[20:])):
        write_db3(tmp_path / f"run_{i}.db3", sent=part)
    write_metadata(tmp_path, ["old_name/run_0.db3", "run_1.db3"])
    (episode,) = load(tmp_path, BAG_MAP).trajectories
    assert_as_recorded(episode)


def test_a_bag_whose_storage_is_mcap_is_read_as_that(tmp_path):
    pytest.importorskip("mcap")
    write_json_mcap(tmp_path / "run_0.mcap")
    write_metadata(tmp_path, ["run_0.mcap"], storage_identifier="mcap")
    assert_as_recorded(load(tmp_path, BAG_MAP).trajectories.episodes[0])


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("DROP TABLE messages", "no rosbag2 bag: expected tables topics and messages, got mes"),
        ("DELETE FROM messages", "is empty; expected messages"),
        ("UPDATE messages SET data = substr(data, 1, 30)", "topic /.* at log time .* cannot be decoded as "),
        ("UPDATE messages SET data = x'28b52ffd00'", "cannot be decoded as .*: it is compressed"),
        ("UPDATE messages SET timestamp = 'noon'", "a message has time 'noon', expected ns and bytes"),
        ("UPDATE topics SET serialization_format = 'json'", "serialised as 'json'; expected cdr"),
        ("UPDATE topics SET name = '/joints' WHERE id = 0", "of no topic in it; .*topics are: /command, /joints"),
        ("UPDATE message_definitions SET encoded_message_definition = 'no [definition'", "definition of .* is not"),
    ],
)  # fmt: skip
def test_a_damaged_bag_is_named_with_what_is_wrong(statement, message, tmp_path):
    pytest.importorskip("mcap_ros2")
    path = change(write_db3(tmp_path / "run_0.db3"), statement)
    with pytest.raises(RecordingError, match=rf"run_0\.db3: .*{message}"):
        load(path, BAG_MAP)


def test_a_view_in_place_of_a_table_is_not_run(tmp_path):
    endless = "CREATE VIEW messages AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x FROM n) SELECT x FROM n"
    path = change(write_db3(tmp_path / "run_0.db3"), "DROP TABLE messages", endless)
    with pytest.raises(RecordingError, match="expected tables topics and messages"):
        load(path, BAG_MAP)


def test_a_type_that_nobody_defines_is_named_with_the_way_out(tmp_path):
    pytest.importorskip("rosbags")
    path = write_db3(tmp_path / "run_0.db3", definitions=False)
    with pytest.raises(RecordingError, match=r"type my_msgs/msg/State, .* `ros2 bag convert"):
        load(change(path, "UPDATE topics SET type = 'my_msgs/msg/State'"), BAG_MAP)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "expected relative_file_paths in rosbag2_bagfile_information"),
        ({"relative_file_paths": []}, "expected relative_file_paths"),
        ({"relative_file_paths": ["../../etc/passwd"]}, r"names files that are not in its folder: passwd"),
        ({"relative_file_paths": ["run_0.db3"], "compression_mode": "MESSAGE"}, "the bag is compressed; `ros2 bag"),
    ],
)  # fmt: skip
def test_metadata_that_cannot_be_right_are_named(content, message, tmp_path):
    write_db3(tmp_path / "run_0.db3")
    (tmp_path / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    with pytest.raises(RecordingError, match=message):
        load(tmp_path, BAG_MAP)


def test_messages_that_are_not_in_the_file_yet_are_not_lost_in_silence(tmp_path):
    path = write_db3(tmp_path / "run_0.db3")
    (tmp_path / "run_0.db3-wal").write_bytes(b"more messages")
    with pytest.raises(RecordingError, match=r"run_0.db3-wal beside it .* wal_checkpoint"):
        load(path, BAG_MAP)


def test_a_message_without_fields_has_no_columns():
    empty = type("Empty", (), {"__slots__": []})
    assert flatten(empty()) == {}
    assert flatten({"q": [1.0, empty()], "more": {"nothing": empty(), "u": 2}}) == {"q[0]": 1.0, "more.u": 2}


# --- ULog -----------------------------------------------------------------------------------------------

ULOG_MAP = {
    "time": {"column": "joints.timestamp", "unit": "us"},
    "joints": {
        name: {"position": f"joints.q[{i}]", "velocity": f"joints.w[{i}]"} for i, name in enumerate(("slider", "hinge"))
    },
    "actuators": {name: f"commands.1.u[{i}]" for i, name in enumerate(("push", "hinge"))},
}


def ulog_message(kind, data):
    return struct.pack("<HB", len(data), ord(kind)) + data


def write_ulog(path, rows=21):
    """A ULog file by its specification; commands are the second of two instances and come 5 ms before the joints."""
    c, out = recorded(rows), b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    out += ulog_message("B", bytes(40))
    out += ulog_message("F", b"joints:uint64_t timestamp;double[2] q;double[2] w;")
    out += ulog_message("F", b"commands:uint64_t timestamp;double[2] u;")
    for instance, number, name in ((0, 0, b"joints"), (0, 1, b"commands"), (1, 2, b"commands")):
        out += ulog_message("A", struct.pack("<BH", instance, number) + name)
    for k in range(rows):
        us = 5_000_000 + round(c["t"][k] * 1e6)
        out += ulog_message("D", struct.pack("<HQ2d", 1, us - 7000, 99, 99))
        out += ulog_message("D", struct.pack("<HQ2d", 2, us - 5000, c["u"][k], c["tau"][k]))
        out += ulog_message("D", struct.pack("<HQ4d", 0, us, c["x"][k], c["q"][k], c["v"][k], c["w"][k]))
    path.write_bytes(out)
    return path


def test_ulog_is_what_was_written_and_instances_are_told_apart(tmp_path):
    pytest.importorskip("pyulog")
    imported = load(write_ulog(tmp_path / "flight.ulg"), ULOG_MAP)
    assert_as_recorded(imported.trajectories.episodes[0])
    assert imported.trajectories.dt == 0.02 and imported.timing.regular
    in_ns = ULOG_MAP | {"time": {"column": "joints.log_time", "unit": "ns"}, "infos": {"first": "commands.u[0]"}}
    imported = load(tmp_path / "flight.ulg", in_ns)
    assert_as_recorded(imported.trajectories.episodes[0])
    assert set(imported.trajectories.episodes[0].infos["first"]) == {99}


def test_a_ulog_cut_short_has_the_rows_before_or_is_refused(tmp_path):
    pytest.importorskip("pyulog")
    whole = write_ulog(tmp_path / "flight.ulg").read_bytes()
    lengths = set()
    for cut in range(8, len(whole), 97):
        (tmp_path / "cut.ulg").write_bytes(whole[:cut])
        try:
            (episode,) = load(tmp_path / "cut.ulg", ULOG_MAP).trajectories
        except RecordingError as error:
            assert "cut.ulg" in str(error)
        else:
            n = len(episode) + 1
            lengths.add(n)
            np.testing.assert_allclose(episode.observations["qpos"][:, 0], recorded()["x"][:n])
    assert len(lengths) > 5


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda b: b"", "not a ULog file of PX4: it is empty"),
        (lambda b: b"PK" + b, "not a ULog file of PX4: it begins with b'PKULog"),
        (lambda b: b[:12], "not a readable ULog file"),
        (lambda b: b[:59], "is empty; expected messages"),
        (lambda b: b.replace(b"commands", b"commander", 1), "damaged|of no topic"),
        (lambda b: b[:700] + b"\xff" * 200 + b[900:], "damaged|expected a number"),
        (lambda b: b.replace(struct.pack("<Q", 5_000_000), b"\xff" * 8), "timestamp holds 18446744073709551615"),
    ],
)  # fmt: skip
def test_a_damaged_ulog_is_named(damage, message, tmp_path):
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "flight.ulg")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(RecordingError, match=rf"flight\.ulg: .*({message})"):
        load(path, ULOG_MAP)


@pytest.mark.parametrize(
    ("formats", "message"),
    [
        (b"joints:uint64_t timestamp;a[60000] q;|a:b[60000] q;|b:double[60000] q;", r"'\w+' has \d+ fields; at most"),
        (b"joints:uint64_t timestamp;a[2] q;|a:joints[2] q;", "is part of itself"),
    ],
)  # fmt: skip
def test_ulog_formats_without_end_are_refused_at_once(formats, message, tmp_path):
    pytest.importorskip("pyulog")
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + ulog_message("B", bytes(40))
    out += b"".join(ulog_message("F", text) for text in formats.split(b"|"))
    out += ulog_message("A", struct.pack("<BH", 0, 0) + b"joints") + ulog_message("D", bytes(100))
    (tmp_path / "flight.ulg").write_bytes(out)
    with pytest.raises(RecordingError, match=rf"flight\.ulg: .*{message}"):
        load(tmp_path / "flight.ulg", ULOG_MAP)


# --- JSON lines -----------------------------------------------------------------------------------------

JSONL_MAP = {
    "time": {"column": "header.stamp", "unit": "ns"},
    "joints": {n: {"position": f"arm.q[{i}]", "velocity": f"arm.w[{i}]"} for i, n in enumerate(("slider", "hinge"))},
    "actuators": {"push": "u", "hinge": "motors[1].tau"},
}


def lines(rows=21):
    c = recorded(rows)
    for k in range(rows):
        ns = START + round(c["t"][k] * 1e9)
        arm = {"q": [c["x"][k], c["q"][k]], "w": [c["v"][k], c["w"][k]]}
        yield {
            "header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}, "arm": arm, "u": c["u"][k], "mode": "run",
            "motors": [{"tau": 0.0}, {"tau": c["tau"][k]}], "scan": [0] * 1000, "fault": None,
        }  # fmt: skip


def write_jsonl(path, rows=None):
    path.write_text("\n".join(map(json.dumps, lines() if rows is None else rows)) + "\n")
    return path


def test_json_lines_are_what_was_written(tmp_path):
    imported = load(write_jsonl(tmp_path / "run.jsonl"), JSONL_MAP | {"infos": {"mode": "mode"}})
    assert_as_recorded(imported.trajectories.episodes[0])
    assert imported.trajectories.dt == 0.02 and set(imported.trajectories.episodes[0].infos["mode"]) == {b"run"}


def test_flat_json_lines_take_the_map_of_a_table(tmp_path):
    columns = recorded()
    rows = [{k: float(v) for k, v in zip(columns, row, strict=True)} for row in zip(*columns.values(), strict=True)]
    assert_as_recorded(load(write_jsonl(tmp_path / "run.jsonl", rows), MAP).trajectories.episodes[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected one JSON object a line"),
        ("{}\n{}\n", "is empty"),
        ("[1, 2]\n", "line 1: expected a JSON object .*got '\\[1, 2\\]"),
        ('{"t": 0}\n\n{"t": 1', r"line 3: not JSON: .*delete the line if the recorder was cut off there"),
        ('{"t": ' + "9" * 5000 + "}", "line 1: not JSON"),
        ("[" * 100_000, "line 1: not JSON: it is nested too deeply"),
        ('{"t": "' + "x" * 1_000_001 + '"}', "line 1 is longer than 1000000 characters"),
        ("\n".join(json.dumps({f"{i}_{j}": 0 for j in range(999)}) for i in range(9)), "line 5: more than 4096"),
        ('{"t": 0}\n{"x": 1}\n', "no column 'q'"),
        ('{"q": 0, "x": 1}\n{"x": 1}\n', "column 'q', line 2: expected a number, got nan or nothing"),
        ('{"q": 0, "x": 1}\n{"q": "a", "x": 1}\n', "column 'q', line 2: expected a number, got 'a'"),
        ('{"q": 1' + "0" * 400 + ', "x": 1}\n{"q": 1, "x": 1}\n', "column 'q', line 1: expected a number, got inf"),
        ('{"q": 1, "x": 1}\n{"q": true, "x": [1]}\n', "column 'x', line 2: expected a number, got nan"),
    ],
)  # fmt: skip
def test_lines_that_cannot_be_right_are_named(text, message, tmp_path):
    (tmp_path / "bad.jsonl").write_text(text)
    with pytest.raises(RecordingError, match=rf"bad\.jsonl: .*{message}"):
        load(tmp_path / "bad.jsonl", {"dt": 0.1, "joints": {"a": {"position": "q"}, "b": {"position": "x"}}})


# --- all three ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bad.db3", "bad.ulg", "bad.jsonl"])
@pytest.mark.parametrize("content", [b"", b"nothing of the kind", b"\xff\xfe\0\1" * 50], ids=["empty", "text", "bytes"])
def test_a_file_of_another_kind_is_named(name, content, tmp_path):
    if name == "bad.ulg":
        pytest.importorskip("pyulog")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=f"{name}: (not a|is empty|line 1)"):
        load(tmp_path / name)


@pytest.mark.parametrize("size", [0.005, 0.2, 0.5, 0.9])
def test_a_bag_cut_short_is_named(size, tmp_path):
    pytest.importorskip("mcap_ros2")
    whole = write_db3(tmp_path / "run_0.db3").read_bytes()
    (tmp_path / "run_0.db3").write_bytes(whole[: int(size * len(whole))])
    with pytest.raises(RecordingError, match=r"run_0.db3: .*(cut short|not a readable)"):
        load(tmp_path / "run_0.db3", BAG_MAP)


def assert_damage_is_refused_or_harmless(path, mapping):
    """Sixty times some bytes of a file are other ones; it is left damaged."""
    whole = path.read_bytes()
    rng, refused = np.random.default_rng(0), 0
    for _ in range(60):
        data = np.frombuffer(whole, np.uint8).copy()
        data[rng.integers(0, len(data), rng.integers(1, 20))] = rng.integers(0, 256)
        path.write_bytes(data.tobytes())
        try:
            (episode, *_) = load(path, mapping).trajectories
            assert np.isfinite(episode.observations["qpos"]).all()
        except RecordingError as error:
            refused += 1
            assert path.name in str(error) and len(str(error)) < 2000
    assert refused > 5


@pytest.mark.parametrize("name", ["run.ulg", "run.db3"])
def test_random_damage_is_refused_or_gives_finite_numbers(name, tmp_path):
    pytest.importorskip({"run.ulg": "pyulog", "run.db3": "mcap_ros2"}[name])
    write, mapping = {"run.ulg": (write_ulog, ULOG_MAP), "run.db3": (write_db3, BAG_MAP)}[name]
    assert_damage_is_refused_or_harmless(write(tmp_path / name), mapping)


@pytest.mark.parametrize(("name", "modules"), [("run.ulg", ["pyulog"]), ("run.db3", ["mcap_ros2.decoder"])])
def test_a_missing_package_names_the_pip_command(name, modules, tmp_path, monkeypatch):
    import sys

    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
    write = write_ulog if name == "run.ulg" else write_db3
    with pytest.raises(RecordingError, match=rf'{name}: .* is not installed; pip install "idapt\[import\]"'):
        load(write(tmp_path / name), BAG_MAP)
