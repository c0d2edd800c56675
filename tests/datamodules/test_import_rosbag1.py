"""Bags of ROS 1: written by rosbags, read without ROS, damaged in every way; no definition of theirs is run."""

import numpy as np
import pytest
from test_import import MCAP_MAP, assert_as_recorded, load, messages
from test_import_logs import assert_damage_is_refused_or_harmless

from datamodules.recordings import RecordingError
from datamodules.recordings.read_rosbag1 import plain_definition

rosbag1 = pytest.importorskip("rosbags.rosbag1")
typesys = pytest.importorskip("rosbags.typesys")
KINDS = {"/joint_states": "sensor_msgs/msg/JointState", "/command": "std_msgs/msg/Float64MultiArray"}


def write_bag(path, compression=None):
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    t = types.types
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        ends = {topic: writer.add_connection(topic, kind, typestore=types) for topic, kind in KINDS.items()}
        for k, (topic, ns, content) in enumerate(messages()):
            if topic == "/command":
                message = t[KINDS[topic]](t["std_msgs/msg/MultiArrayLayout"]([], 0), np.array(content["data"]))
            else:
                stamp = t["builtin_interfaces/msg/Time"](*content["header"]["stamp"].values())
                values = (np.array(content[k]) for k in ("position", "velocity"))
                header = t["std_msgs/msg/Header"](k, stamp, "base")
                message = t[KINDS[topic]](header, content["name"], *values, np.zeros(0))
            writer.write(ends[topic], ns, types.serialize_ros1(message, KINDS[topic]))
    return path


@pytest.mark.parametrize("compression", [None, *rosbag1.Writer.CompressionFormat], ids=str)
def test_a_bag_is_what_was_sent(compression, tmp_path):
    imported = load(write_bag(tmp_path / "run.bag", compression), MCAP_MAP)
    assert_as_recorded(imported.trajectories.episodes[0])
    assert imported.trajectories.dt == 0.02 and imported.timing.regular


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V1.2\n", b"\xff\xfe\0\1" * 50], ids=["empty", "old", "bytes"])
def test_a_file_of_another_kind_is_named(content, tmp_path):
    (tmp_path / "bad.bag").write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.bag: not a bag of ROS 1, version 2\.0"):
        load(tmp_path / "bad.bag", MCAP_MAP)


@pytest.mark.parametrize("size", [0.01, 0.3, 0.9])
def test_a_bag_cut_short_is_named(size, tmp_path):
    whole = write_bag(tmp_path / "run.bag").read_bytes()
    (tmp_path / "run.bag").write_bytes(whole[: int(size * len(whole))])
    with pytest.raises(RecordingError, match=r"run\.bag: .*not .*readable"):
        load(tmp_path / "run.bag", MCAP_MAP)


def test_a_bag_that_was_not_closed_says_how_to_mend_it(tmp_path):
    whole = write_bag(tmp_path / "run.bag").read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    (tmp_path / "run.bag").write_bytes(whole[:at] + bytes(8) + whole[at + 8 :])
    with pytest.raises(RecordingError, match=r"run\.bag: .* not indexed.*rosbag reindex"):
        load(tmp_path / "run.bag", MCAP_MAP)


def test_random_damage_is_refused_or_gives_finite_numbers(tmp_path):
    assert_damage_is_refused_or_harmless(write_bag(tmp_path / "run.bag"), MCAP_MAP)


def test_a_definition_keeps_its_fields_alone():
    text = "# what it is\nHeader header\nuint8 GOOD=1 # fine\nstring NAME = a # b\nfloat64[3] p  # m\n"
    text += "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\n"
    assert [line for line in plain_definition("x", text).splitlines() if line and line[0] != "="] == [
        *("Header header", "float64[3] p", "MSG: std_msgs/Header", "uint32 seq", "time stamp")
    ]


@pytest.mark.parametrize(
    "line", ["float64 x; import os", "float64[__import__('os')] x", "float64 x y", "MSG: a/b/c(d)"]
)
def test_a_definition_that_is_more_than_names_and_numbers_is_refused(line):
    with pytest.raises(RecordingError, match=r"run\.bag: line .* is no field"):
        plain_definition("run.bag", f"uint32 seq\n{line}\n")


def test_a_missing_package_names_the_pip_command(tmp_path, monkeypatch):
    import sys

    path = write_bag(tmp_path / "run.bag")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(RecordingError, match=r'run.bag: .* is not installed; pip install "idapt\[import\]"'):
        load(path, MCAP_MAP)
