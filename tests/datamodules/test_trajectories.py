"""Trajectory files: what is written is read; what is broken is named."""

import os
import subprocess

import h5py
import numpy as np
import pytest

from datamodules import Episode, Trajectories, TrajectoryFileError, read_trajectories, write_trajectories
from datamodules.trajectories import count_steps


def full_episode(T=4):
    rng = np.random.default_rng(0)
    return Episode(
        actions=rng.normal(size=(T, 2)).astype(np.float32),
        observations={
            "pixels": rng.integers(0, 256, (T + 1, 8, 6, 3), np.uint8),
            "state": rng.normal(size=(T + 1, 3)),
        },
        rewards=rng.normal(size=T),
        terminations=np.arange(T) == T - 1,
        truncations=np.zeros(T, bool),
        timestamps=np.cumsum(rng.random(T + 1) + 0.1),
        infos={"current": rng.normal(size=(T, 2))},
    )


@pytest.fixture
def path(tmp_path):
    return tmp_path / "data" / "d.h5"


@pytest.fixture
def written(path):
    write_trajectories(path, Trajectories((full_episode(4), full_episode(2)), 0.04, "a test"))
    return path


def test_round_trip_keeps_everything(written):
    read = read_trajectories(written)
    assert (len(read), read.total_steps, read.dt, read.source) == (2, 6, 0.04, "a test")
    for episode, original in zip(read, (full_episode(4), full_episode(2)), strict=True):
        for name in ("actions", "rewards", "terminations", "truncations", "timestamps"):
            a, b = getattr(episode, name), getattr(original, name)
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for group in ("observations", "infos"):
            a, b = getattr(episode, group), getattr(original, group)
            assert a.keys() == b.keys()
            for name in a:
                np.testing.assert_array_equal(a[name], b[name])
                assert a[name].dtype == b[name].dtype


def test_round_trip_of_a_target_episode_keeps_it_without_rewards(path, numbered):
    write_trajectories(path, numbered([3], state=False))
    (episode,) = read_trajectories(path)
    assert (episode.rewards, episode.terminations, episode.truncations, episode.timestamps) == (None,) * 4
    assert set(episode.observations) == {"pixels"} and episode.infos == {}
    with h5py.File(path) as f:
        assert set(f["episode_0"]) == {"actions", "observations"}


def test_file_has_the_documented_layout(written):
    with h5py.File(written) as f:
        assert dict(f.attrs) == {"total_episodes": 2, "total_steps": 6, "dt": 0.04, "source": "a test"}
        assert dict(f["episode_1"].attrs) == {"id": 1, "total_steps": 2}
        assert f["episode_1/observations/pixels"].shape == (3, 8, 6, 3)
        assert f["episode_0/infos/current"].shape == (4, 2)


def test_truncated_file_is_an_error_that_names_it(written):
    content = written.read_bytes()
    written.write_bytes(content[: len(content) // 2])
    with pytest.raises(TrajectoryFileError, match=r"d\.h5.*truncated"):
        read_trajectories(written)


def test_file_of_another_kind_is_an_error_that_names_it(path):
    path.parent.mkdir()
    path.write_text("time,action\n0,1\n")
    with pytest.raises(TrajectoryFileError, match=r"d\.h5.*HDF5"):
        read_trajectories(path)


def test_missing_file_is_an_error_that_names_it(path):
    with pytest.raises(TrajectoryFileError, match=r"d\.h5: no such file"):
        read_trajectories(path)


def test_foreign_hdf5_is_an_error_that_names_the_missing_attribute(path):
    path.parent.mkdir()
    with h5py.File(path, "w") as f:
        f["x"] = [1, 2]
    with pytest.raises(TrajectoryFileError, match=r"d\.h5: not a trajectory file.*'total_episodes'"):
        read_trajectories(path)


@pytest.mark.parametrize("missing", ["episode_1", "episode_1/actions", "episode_1/observations"])
def test_missing_group_or_dataset_is_an_error_that_names_file_and_episode(written, missing):
    with h5py.File(written, "a") as f:
        del f[missing]
    with pytest.raises(TrajectoryFileError, match=r"d\.h5: episode_1"):
        read_trajectories(written)


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("actions", np.zeros(4), r"actions have shape \(4,\), expected \(T, nu\)"),
        ("actions", np.full((4, 2), np.nan), "actions hold NaN"),
        ("observations/state", np.zeros((4, 3)), r"observations/state has 4 rows, expected T\+1 = 5"),
        ("observations/pixels", np.zeros((5, 8, 6, 3)), r"pixels is float64.*expected uint8"),
        ("observations/pixels", np.zeros((5, 3, 8, 6), np.uint8), r"pixels is uint8 \(5, 3, 8, 6\)"),
        ("rewards", np.zeros(5), r"rewards has shape \(5,\), expected \(T,\) = \(4,\)"),
        ("timestamps", np.array([0.0, 1.0, 3.0, 2.0, 4.0]), "timestamps must be 5 increasing"),
    ],
)
def test_wrong_shape_is_an_error_that_names_file_dataset_and_what_was_expected(written, dataset, value, message):
    with h5py.File(written, "a") as f:
        del f["episode_0"][dataset]
        f["episode_0"][dataset] = value
    with pytest.raises(TrajectoryFileError, match=rf"d\.h5: episode_0: .*{message}"):
        read_trajectories(written)


@pytest.mark.parametrize("failure", [OSError("no space left on device"), RuntimeError("can't flush")])
def test_writing_failure_leaves_nothing_behind(path, monkeypatch, numbered, failure):
    break_writing(monkeypatch, failure)
    with pytest.raises(OSError, match=r"could not write .*d\.h5"):
        write_trajectories(path, numbered([2, 2]))
    assert not path.parent.exists()


def test_writing_failure_keeps_the_file_that_was_there(written, monkeypatch, numbered):
    before = written.read_bytes()
    break_writing(monkeypatch, OSError("no space left on device"))
    with pytest.raises(OSError):
        write_trajectories(written, numbered([2, 2]))
    assert written.read_bytes() == before and os.listdir(written.parent) == ["d.h5"]


def break_writing(monkeypatch, failure):
    """The second episode fails: half a file has been written by then."""
    import datamodules.trajectories as module

    write = module._write_episode

    def write_one(group, i, episode):
        if i:
            raise failure
        write(group, i, episode)

    monkeypatch.setattr(module, "_write_episode", write_one)


def test_an_episode_without_steps_is_refused():
    with pytest.raises(ValueError, match="T >= 1"):
        Episode(np.zeros((0, 2), np.float32), {})


def test_adding_keeps_order(numbered):
    both = numbered([2]) + numbered([3], first=2)
    assert [len(e) for e in both] == [2, 3] and both.total_steps == 5


def test_what_a_killed_process_left_of_the_same_file_is_removed(path, numbered):
    gone = subprocess.Popen(["true"])
    gone.wait()
    path.parent.mkdir()
    for name in (path.name, "other.h5"):
        (path.parent / f".{name}.{gone.pid}.tmp").write_text("half")
    write_trajectories(path, numbered([2]))
    assert sorted(os.listdir(path.parent)) == sorted([path.name, f".other.h5.{gone.pid}.tmp"])


def test_actions_are_counted_and_an_attribute_that_disagrees_is_an_error(written):
    with h5py.File(written, "a") as f:
        f.attrs["total_steps"] = 5
    assert count_steps(written) == 6
    with pytest.raises(TrajectoryFileError, match=r"d\.h5: its episodes have 6 actions, but .*total_steps is 5"):
        read_trajectories(written)


def test_no_damage_to_a_file_is_a_traceback(written):
    """Single bytes, all over it: HDF5 notices, or what was read is checked, or nothing shows."""
    whole = written.read_bytes()
    for start in range(0, len(whole), 97):
        written.write_bytes(whole[:start] + bytes([whole[start] ^ 0xFF]) + whole[start + 1 :])
        for read in (read_trajectories, count_steps):
            try:
                read(written)
            except TrajectoryFileError as error:
                assert str(error).startswith(f"{written}: ")
