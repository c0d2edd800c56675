"""Damage of a run's JSON files is found and named."""

import json

import pytest

from idapt_pl.files import DamagedFile, blaming, read_json, sha256, verify, write_json

VALUE = {"mean": 12.5, "returns": [1.0, 24.0], "F": None, "name": "ü"}


@pytest.fixture
def path(tmp_path):
    write_json(tmp_path / "e.json", VALUE, checked=True)
    return tmp_path / "e.json"


def test_what_is_written_is_read_and_the_checksum_stays_in_the_file(path):
    assert read_json(path) == VALUE and "checksum" in json.loads(path.read_text())


def test_no_single_byte_can_change_what_is_read(path):
    whole = path.read_bytes()
    for i in range(len(whole)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        try:
            read = read_json(path)
        except DamagedFile as error:
            assert str(error).startswith(f"{path}: cannot be used") and "Delete it" in str(error)
        else:  # white space, or the checksum's own name
            assert {k: v for k, v in read.items() if k in VALUE} == VALUE, i


@pytest.mark.parametrize("content", ["", "{", "[1]", "3", '{"a": ', '"text"', "[" * 5000, "\x00"])
def test_what_is_no_json_object_is_an_error_that_names_the_file(path, content):
    path.write_text(content)
    with pytest.raises(DamagedFile, match=r"e\.json: cannot be used .*Delete it"):
        read_json(path)


def test_a_key_that_must_be_there_is_named(path):
    with pytest.raises(DamagedFile, match=r"e\.json: .*'target' is missing"):
        read_json(path, ("mean", "target"))


def test_files_without_a_checksum_are_read_as_before(path):
    path.write_text(json.dumps(VALUE))
    assert read_json(path) == VALUE


def test_whatever_fails_is_said_in_one_line_with_its_cure(tmp_path):
    with pytest.raises(DamagedFile) as error, blaming(tmp_path / "f.json", "Ask."):
        {}["mean"]
    assert str(error.value) == f"{tmp_path / 'f.json'}: cannot be used (it does not hold 'mean'). Ask."
    with (
        pytest.raises(DamagedFile, match="f: cannot be used") as error,
        blaming(tmp_path / "g"),
        blaming(tmp_path / "f"),
    ):
        raise TypeError("two\nlines")
    assert "\n" not in str(error.value), "the file that is damaged is named, not the one that is read with it"


def test_a_recording_is_compared_with_its_note_if_it_has_one(tmp_path):
    recording = tmp_path / "target.h5"
    recording.write_bytes(b"content")
    verify(recording)
    write_json(tmp_path / "target.json", {"stage": "target", "sha256": sha256(recording)}, checked=True)
    verify(recording)
    recording.write_bytes(b"contend")
    with pytest.raises(DamagedFile, match=r"target\.h5: .*checksum in target\.json"):
        verify(recording)
    (tmp_path / "target.json").write_text("{")
    with pytest.raises(DamagedFile, match=r"target\.json: .*Delete it: all it holds"):
        verify(recording)
