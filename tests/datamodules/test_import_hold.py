"""Topics at different rates in one table: the last value holds in empty cells."""

import numpy as np
import pytest
import yaml
from test_import import MAP, MODEL, changed, recorded, write_csv

from cli.import_ import read_layout
from datamodules.recordings import RecordingError, convert, draft_map, parse_mapping, read_recording
from datamodules.recordings.draft_text import draft_text

HELD = {"push": {"column": "u", "hold": True}, "hinge": {"column": "tau", "hold": True}}


def joined(early=0, every=1):
    """A table as outer joins make it: measurements in one row, commands in the next, with a clock of their own.

    Args:
        early: rows of measurements before the first command.
        every: so many rows of measurements to a command.
    """
    c = recorded()
    table = {name: [] for name in c}
    for k in range(21):
        commanded = k >= early and (k - early) % every == 0
        for here, time in ((("u", "tau"), c["t"][k] - 0.003), (("x", "v", "q", "w"), c["t"][k]))[
            0 if commanded else 1 :
        ]:
            for name in c:
                table[name].append(c[name][k] if name in here else time if name == "t" else "")
    return table


def imported(path, mapping, repair=False):
    mapping = parse_mapping(mapping)
    return convert(read_recording(path, mapping), mapping, repair=repair)


@pytest.mark.parametrize(("early", "every"), [(0, 1), (3, 1), (0, 5), (2, 4)])
def test_the_last_command_holds_and_rows_are_those_of_the_measurements(early, every, tmp_path):
    out = imported(write_csv(tmp_path / "run.csv", joined(early, every)), changed(actuators=HELD))
    (episode,), c = out.trajectories, recorded()
    np.testing.assert_allclose(episode.observations["qpos"], np.stack([c["x"], c["q"]], 1)[early:])
    sent = np.arange(early, 20) - (np.arange(early, 20) - early) % every
    np.testing.assert_allclose(episode.actions[:, 1], c["tau"][sent], rtol=1e-6)
    assert out.trajectories.dt == 0.02 and out.timing.regular
    left_out = len(range(early, 21, every)) + early
    assert out.notes[0].startswith(f"{left_out} rows are left out that have held channels alone")


def test_without_it_both_errors_name_it(tmp_path):
    path = write_csv(tmp_path / "run.csv", joined())
    for repair in (False, True):
        with pytest.raises(RecordingError, match="let the last value hold \\(hold: true of the channel"):
            imported(path, MAP, repair)


def test_values_do_not_hold_from_one_episode_to_the_next(tmp_path):
    c = {name: [*column, *column] for name, column in (recorded() | {"u": ["", "", *range(19)]}).items()}
    path = write_csv(tmp_path / "run.csv", c | {"run": [1] * 21 + [2] * 21})
    mapping = changed(episodes={"column": "run"}, actuators={"push": HELD["push"]})
    assert [list(e.actions[:, 0]) for e in imported(path, mapping).trajectories] == [list(range(18))] * 2


def test_only_empty_cells_are_filled(tmp_path):
    path = write_csv(tmp_path / "run.csv", recorded() | {"u": [1, "", "x", *range(18)]})
    with pytest.raises(RecordingError, match="line 4: expected a number, got 'x'"):
        imported(path, changed(actuators=HELD))
    path = write_csv(tmp_path / "run.csv", recorded() | {"u": [""] * 21})
    with pytest.raises(RecordingError, match="column 'u' is empty, and the map holds its last value"):
        imported(path, changed(actuators=HELD))
    with pytest.raises(RecordingError, match=r"actuators\.push\.hold: expected True or False, got 3"):
        parse_mapping(changed(actuators={"push": {"column": "u", "hold": 3}}))


@pytest.mark.parametrize("every", [1, 5])
def test_a_draft_holds_what_has_the_name_but_is_empty_in_most_rows(every, tmp_path):
    (tmp_path / "nominal.xml").write_text(MODEL)
    names = {"x": "slider_pos_m", "q": "hinge_pos_rad", "v": "slider_vel", "w": "hinge_vel", "u": "push_cmd_N"}
    names |= {"t": "t", "tau": "/effort_controller/commands/hinge"}
    path = write_csv(tmp_path / "run.csv", {names[name]: column for name, column in joined(every=every).items()})
    text = draft_text(draft_map(path, read_layout(tmp_path / "nominal.xml")))
    actuators = yaml.safe_load(text)["actuators"]
    hinge = {"column": "/effort_controller/commands/hinge", "hold": True}
    assert actuators["hinge"] == hinge and actuators["push"]["hold"] and text.count("hold: true") == 2
    assert "hinge in its name" in text and "21 empty cells, so the last value holds" in text
    assert len(imported(path, yaml.safe_load(text)).trajectories.episodes[0]) == 20


def test_a_draft_holds_nothing_where_some_numbers_are_missing(tmp_path):
    (tmp_path / "nominal.xml").write_text(MODEL)
    columns = {"t": "t", "slider_pos": "x", "hinge_pos": "q", "push_cmd": "u", "hinge_cmd": "tau"}
    c = {name: recorded()[of] for name, of in columns.items()} | {"hinge_pos": ["", "", *recorded()["q"][2:]]}
    drafted = draft_map(write_csv(tmp_path / "run.csv", c), read_layout(tmp_path / "nominal.xml"))
    assert not drafted.missing() and "hold: true" not in draft_text(drafted)
