"""Topics with clocks that do not match, or that fall silent: refused or told, never held in silence."""

import json

import numpy as np
import pytest
from test_import import MCAP_MAP, START, load, messages

from datamodules.recordings import RecordingError
from datamodules.recordings.clocks import end_of_rows

MS = 1_000_000
STATES = START + 20 * MS * np.arange(500)
"""10 s of rows, 20 ms apart."""


def told(*, command):
    return end_of_rows("run.db3", "/states", {"/states": STATES, "/command": np.asarray(command)})


def test_clocks_that_belong_together_are_no_matter():
    assert told(command=STATES - 5 * MS) == (None, ())
    assert told(command=STATES[:480] + 7 * MS) == (None, ())  # 0.4 s of silence


@pytest.mark.parametrize(
    ("command", "by"),
    [
        (STATES + 3_600_000 * MS, "/command begins 3590.02 s after /states ends"),
        (STATES - 3_600_000 * MS, "/command ends 3590.02 s before /states begins"),
        (STATES - START, r"/command ends 1.7e\+09 s before /states begins"),
        (STATES[-1:] + 250 * MS, "/command begins 0.25 s after /states ends"),
        (STATES[:1] - 20_000 * MS, "/command ends 20 s before /states begins"),
    ],
    ids=["later", "earlier", "since boot", "one message after", "one message long before"],
)
def test_clocks_that_do_not_overlap_are_an_error_that_says_by_how_much(command, by):
    with pytest.raises(RecordingError, match=f"^run.db3: the clocks of its topics do not match: {by}"):
        told(command=command)


def test_a_single_target_from_before_is_held():
    assert told(command=STATES[:1] - 5_000 * MS) == (None, ())
    assert told(command=STATES[100:101])[0] is None


def test_a_stream_that_stops_ends_the_rows():
    end, (note,) = told(command=STATES[:250])
    assert end == STATES[249] + 20 * MS
    assert note.startswith("run.db3: topic /command ends 5 s before /states, and never paused for more than 0.02 s")


def test_the_first_stream_to_stop_ends_them():
    times = {"/states": STATES, "/a": STATES[:250], "/b": STATES[:100], "/c": STATES}
    end, notes = end_of_rows("run.db3", "/states", times)
    assert end == STATES[100] and len(notes) == 2


@pytest.mark.parametrize("sent", [STATES[[0, 50, 100]], STATES[[*range(0, 50), *range(200, 300)]]])
def test_commands_that_pause_now_and_then_are_held_and_that_is_said(sent):
    end, (note,) = told(command=sent)
    assert end is None and note.endswith("its last message is held until there")


def test_a_topic_that_begins_late_is_told():
    end, (note,) = told(command=STATES[100:])
    assert end is None and note == "run.db3: topic /command begins 2 s after /states: rows before it are left out"


def write_mcap(path, sent):
    from mcap.writer import Writer

    with path.open("wb") as f:
        writer = Writer(f)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, "json", schema) for t in ("/joint_states", "/command")}
        for topic, ns, content in sent:
            writer.add_message(channels[topic], ns, json.dumps(content).encode(), ns)
        writer.finish()
    return path


def test_a_log_whose_commands_stop_is_read_up_to_there(tmp_path):
    pytest.importorskip("mcap")
    sent = [m for m in messages(400) if m[0] == "/joint_states" or m[1] < START + 4_000 * MS]
    imported = load(write_mcap(tmp_path / "run.mcap", sent), MCAP_MAP)
    assert imported.trajectories.total_steps == 200
    assert "run.mcap: topic /command ends 3.99 s before /joint_states" in imported.notes[0]


def test_a_log_of_two_clocks_is_refused(tmp_path):
    pytest.importorskip("mcap")
    sent = [(topic, ns - (topic == "/command") * 60_000 * MS, content) for topic, ns, content in messages()]
    with pytest.raises(RecordingError, match=r"run.mcap: .*/command ends 59.6\d* s before /joint_states begins"):
        load(write_mcap(tmp_path / "run.mcap", sorted(sent, key=lambda m: m[1])), MCAP_MAP)
