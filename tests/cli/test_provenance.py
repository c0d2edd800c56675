"""Which code made a result."""

import subprocess

import pytest

from cli import provenance


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout whose code is ``cli/code.py`` and whose tables are in ``results``."""
    for name in ("cli/code.py", "results/table.csv"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("1\n")
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    for command in (("init", "-q"), ("add", "."), (*who, "commit", "-q", "-m", "first")):
        subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "cli/code.py"))
    return tmp_path


def test_a_commit_is_told_and_whether_the_code_was_changed_since(checkout):
    commit = provenance.git_commit()
    assert len(commit) == 40
    (checkout / "results/table.csv").write_text("2\n")
    assert provenance.git_commit() == commit, "a benchmark that writes its table changes no code"
    (checkout / "cli/code.py").write_text("2\n")
    assert provenance.git_commit() == f"{commit}+dirty"


def test_a_new_file_is_a_change(checkout):
    (checkout / "new.py").write_text("")
    assert provenance.git_commit().endswith("+dirty")


def test_outside_a_checkout_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "cli/code.py"))
    assert provenance.git_commit() is None
