"""YAML is data, and what would explode is refused before it does."""

import time

import pytest

from datamodules.safe_yaml import LARGEST, NODES, read_yaml

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
MERGES = "a0: &a0 {x: 1, y: 2}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12)
)


@pytest.fixture
def written(tmp_path):
    def write(content):
        path = tmp_path / "m.yaml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def test_what_is_written_is_read_and_aliases_are_copies(written):
    assert read_yaml(written("a: &x {b: [1, 2.5, true]}\nc: *x\nd: {<<: *x, e: ü}\n")) == {
        "a": {"b": [1, 2.5, True]}, "c": {"b": [1, 2.5, True]}, "d": {"b": [1, 2.5, True], "e": "ü"},
    }  # fmt: skip
    assert read_yaml(written("")) is None


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (BOMB, f"more than {NODES} values"),
        (MERGES, f"more than {NODES} values"),
        ("a: &a [*a]", "part of"),
        ("[" * 5000, "nested too deeply"),
        ("x" * (LARGEST + 1), f"more than {LARGEST} is not read"),
        ("a: 1\na: 2\n", "'a' stands twice"),
        ("a: [", "not valid YAML"),
        ("a: 2020-13-45", "not valid YAML"),
        ("a: " + "9" * 5000, "not valid YAML"),
        ("{[a]: 1}", "not valid YAML"),
        ("a: !!python/object/apply:os.getcwd []", "not valid YAML"),
        (b"\xff\xfe\x00a", "not a text file"),
        (b"a: \x00", "not valid YAML"),
    ],
)
def test_what_cannot_be_read_is_told_at_once_and_by_name(written, content, told):
    started = time.process_time()  # not of the clock: others may be at work on this machine
    with pytest.raises(ValueError, match=rf"m\.yaml: .*{told}") as error:
        read_yaml(written(content))
    assert time.process_time() - started < 2 and "\n" not in str(error.value)


def test_a_file_that_is_not_there_or_a_folder_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.yaml: No such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(ValueError, match="Is a directory"):
        read_yaml(tmp_path)
