"""`--repair` drops single slips of the clock and nothing else; a map's alternatives take the column that is there."""

import numpy as np
import pytest
from test_import import MAP, assert_as_recorded, changed, recorded, run, write_csv

from cli.import_ import import_recordings, read_layout
from datamodules.recordings import RecordingError, convert, fit_to_model, parse_mapping, read_recording
from datamodules.recordings.repair import rows_to_drop
from datamodules.trajectories import read_trajectories

# --- times ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "dropped"),
    [
        ([0, 1, 2, 3], []),
        ([0, 1, 1, 2, 3], [2]),
        ([0, 1, 2, 1.5, 3], [3]),
        ([0, 1, 2, 0, 3], [3]),
        ([0, 1, 2, 2], [3]),
        ([0, 0, 1, 2], [1]),
        ([0, 1, 90, 2, 3], [2]),
        ([90, 1, 2, 3], [0]),
        ([0, 1, 1, 2, 2, 3], [2, 4]),
        ([0, 1, 1, 1, 2], []),
        ([0, 1, 2, 3, 0, 1, 2, 3], []),
        ([3, 2, 1, 0], []),
    ],
)
def test_single_slips_are_dropped_and_nothing_else(times, dropped):
    times = np.array(times, float)
    assert rows_to_drop(times) == dropped
    if dropped:
        assert (np.diff(np.delete(times, dropped)) > 0).all()


def test_slips_put_into_any_recording_are_found(tmp_path):
    rng = np.random.default_rng(0)
    for _ in range(50):
        times = np.cumsum(rng.uniform(0.5, 1.5, 60))
        rows = np.sort(rng.choice(np.arange(1, 20) * 3, 5, replace=False))
        slipped = np.insert(times, rows, [times[k - 1] - rng.choice([0, 0.1, 5]) for k in rows])
        kept = np.delete(slipped, rows_to_drop(slipped))
        assert len(kept) == len(times) and (np.diff(kept) > 0).all()


def slipped(row=7):
    """The usual motion with a row written twice."""
    return {name: np.insert(values, row, values[row]) for name, values in recorded().items()}


def imported(path, mapping=MAP, repair=True):
    return import_recordings([path], parse_mapping(mapping), repair=repair)


def test_a_repeated_row_is_an_error_that_names_the_option_and_is_dropped_with_it(tmp_path):
    path = write_csv(tmp_path / "run.csv", slipped())
    with pytest.raises(
        RecordingError, match=r"line 10: time stands still at 0\.14, .* --repair drops single such rows"
    ):
        imported(path, repair=False)
    result = imported(path)
    assert_as_recorded(result.trajectories.episodes[0])
    assert result.timing.regular
    (note,) = result.notes
    assert note.startswith("1 rows whose time repeats or goes back are left out, the first") and "line 10" in note


def test_commands_that_are_one_row_shorter_keep_their_rows(tmp_path):
    c = slipped()
    np.savez(tmp_path / "run.npz", **c | {k: c[k][:-1] for k in ("u", "tau")})
    assert_as_recorded(imported(tmp_path / "run.npz").trajectories.episodes[0])
    last = {name: np.append(values, values[-1]) for name, values in recorded().items()}
    np.savez(tmp_path / "last.npz", **last | {k: last[k][:-1] for k in ("u", "tau")})
    assert_as_recorded(imported(tmp_path / "last.npz").trajectories.episodes[0])


def test_a_clock_that_was_set_back_stays_an_error(tmp_path):
    c = {name: np.concatenate([values, values]) for name, values in recorded().items()}
    with pytest.raises(RecordingError, match=r"goes back from 0\.4 to 0"):
        imported(write_csv(tmp_path / "run.csv", c))


def test_what_needs_no_repair_stays_as_it_is(tmp_path):
    path = write_csv(tmp_path / "run.csv", recorded())
    whole, repaired = imported(path, repair=False), imported(path)
    np.testing.assert_array_equal(
        whole.trajectories.episodes[0].observations["qpos"], repaired.trajectories.episodes[0].observations["qpos"]
    )
    assert repaired.notes == ("--repair found no row without numbers and no time that repeats or goes back",)


def test_the_command_shows_how_many_rows_were_dropped(tmp_path, capsys):
    import yaml

    path = write_csv(tmp_path / "run.csv", slipped())
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP, sort_keys=False))
    arguments = ["import", path, "--map", tmp_path / "map.yaml", "--out", tmp_path / "d.h5"]
    code, printed = run(arguments, capsys)
    assert code == 1 and "--repair" in printed.err and not (tmp_path / "d.h5").exists()
    code, printed = run([*arguments, "--repair"], capsys)
    assert code == 0 and "1 rows whose time repeats or goes back are left out" in printed.out
    assert_as_recorded(read_trajectories(tmp_path / "d.h5").episodes[0])


# --- alternatives ---------------------------------------------------------------------------------------

EITHER = {
    "time": {"column": ["stamp", "t"], "unit": "s"},
    "joints": {
        "slider": {
            "position": {"column": ["slider_pos", "x"]},
            "velocity": {"column": ["v", "slider_vel"], "unit": "m/s"},
        },
        "hinge": {"position": {"column": ["q", "hinge_pos"], "unit": "rad"}, "velocity": "w"},
    },
    "actuators": {"push": ["clipped", "u"], "hinge": {"column": ["none", "tau", "u"]}},
}


def test_one_map_reads_files_whose_columns_are_called_differently(tmp_path):
    c = recorded()
    other = {"t": "stamp", "x": "slider_pos", "v": "slider_vel", "q": "hinge_pos", "u": "clipped"}
    paths = [
        write_csv(tmp_path / "old.csv", c),
        write_csv(tmp_path / "new.csv", {other.get(name, name): values for name, values in c.items()}),
    ]
    result = import_recordings(paths, parse_mapping(EITHER))
    assert len(result.trajectories) == 2
    for episode in result.trajectories:
        assert_as_recorded(episode)


def test_the_first_column_that_a_file_has_is_taken_and_errors_name_it(tmp_path):
    c = recorded() | {"clipped": np.zeros(21)}
    path = write_csv(tmp_path / "run.csv", c)
    assert not import_recordings([path], parse_mapping(EITHER)).trajectories.episodes[0].actions[:, 0].any()
    c["clipped"] = np.array(["off"] * 21)
    with pytest.raises(RecordingError, match="column 'clipped', line 2: expected a number, got 'off'"):
        import_recordings([write_csv(path, c)], parse_mapping(EITHER))


def test_alternatives_that_a_file_has_none_of_are_named(tmp_path):
    path = write_csv(tmp_path / "run.csv", recorded())
    content = changed(actuators={"push": ["clipped", "desired"], "hinge": "tau"})
    with pytest.raises(
        RecordingError, match=r"run\.csv: none of the columns clipped, desired, .* actuators\.push; col"
    ):
        import_recordings([path], parse_mapping(content))


def test_a_list_is_a_free_joints_columns_unless_the_model_knows_better(tmp_path):
    seven = {"dt": 0.02, "joints": {"root": {"position": {"column": list("abcdefx")}}}}
    assert parse_mapping(seven).joints["root"].position.columns == tuple("abcdefx")
    (tmp_path / "slide.xml").write_text(
        '<mujoco><worldbody><body><joint name="root" type="slide"/><geom size="1"/></body></worldbody></mujoco>'
    )
    mapping = fit_to_model(parse_mapping(seven), read_layout(tmp_path / "slide.xml"))
    path = write_csv(tmp_path / "run.csv", recorded())
    (episode,) = convert(read_recording(path, mapping), mapping).trajectories
    np.testing.assert_allclose(episode.observations["qpos"][:, 0], recorded()["x"])


@pytest.mark.parametrize(
    ("lost", "left"), [((0, 1), [18]), ((19,), [19]), ((8,), [8, 11]), ((5, 7), [5, 12]), ((0, 9, 10, 19), [8, 8])]
)
@pytest.mark.parametrize("column", ["t", "x", "w"])
def test_rows_without_numbers_are_left_out_and_end_an_episode(column, lost, left, tmp_path):
    columns = recorded(20, 0.01)
    columns[column] = columns[column].astype(float)
    columns[column][list(lost)] = np.nan
    path = write_csv(tmp_path / "run.csv", columns)
    with pytest.raises(RecordingError, match="--repair leave such rows out"):
        imported(path, repair=False)
    out = imported(path)
    assert [len(e.actions) + 1 for e in out.trajectories.episodes] == left
    assert out.notes[0].startswith(f"{len(lost)} rows without numbers are left out, the first")
    whole = imported(write_csv(tmp_path / "whole.csv", recorded(20, 0.01)), repair=False).trajectories.episodes[0]
    first = next(k for k in range(20) if k not in lost)
    np.testing.assert_allclose(
        out.trajectories.episodes[0].observations["qpos"], whole.observations["qpos"][first : first + left[0]]
    )


def test_a_recording_without_any_whole_row_is_an_error(tmp_path):
    columns = recorded(20, 0.01) | {"x": np.full(20, np.nan)}
    with pytest.raises(RecordingError, match="no two rows in a row have all numbers of the map"):
        imported(write_csv(tmp_path / "run.csv", columns))
