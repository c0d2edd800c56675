"""Which code made a result."""

import subprocess

import pytest
import yaml
from jsonargparse import ArgumentParser, Namespace

from cli import provenance
from cli.fit import current
from idapt_pl.files import read_json


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


def started(run, policy, divided_by, seed=0):
    """``run.json`` after a start with a length as it is once it is shortened."""
    parser = ArgumentParser()
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--schedule.finetune.policy", type=int, default=4000)
    config = parser.parse_object({"seed": seed, "schedule": {"finetune": {"policy": policy}}})
    provenance.write_provenance(parser, Namespace(config), run, divided_by)
    return read_json(run / "run.json")


@pytest.mark.parametrize("begun", [False, True])
def test_what_lengths_were_divided_by_stays_known_in_resumed_runs(tmp_path, begun):
    assert started(tmp_path, 40, 100.0)["shortened_by"] == 100
    if begun:
        (tmp_path / "step_00").mkdir()
    assert started(tmp_path, 40, 1.0)["shortened_by"] == 100, "config.yaml has the lengths, but no factor"
    assert started(tmp_path, 40, 100.0)["shortened_by"] == 100


def test_a_folder_in_which_nothing_was_done_forgets_the_shortened_run(tmp_path):
    started(tmp_path, 40, 100.0)
    assert "shortened_by" not in started(tmp_path, 4000, 1.0)


def test_another_shortening_is_refused_by_the_option_that_was_typed(tmp_path):
    started(tmp_path, 20, 200.0)
    (tmp_path / "step_00").mkdir()
    with pytest.raises(ValueError, match=r"another config \(--shorten 200 against 100, seed differ\)"):
        started(tmp_path, 40, 100.0, seed=1)


@pytest.mark.parametrize("option", ["", "--config="])
def test_keys_that_are_gone_are_left_out_of_an_older_config_however_it_is_given(tmp_path, option):
    """Sweeps give it with the option."""
    path = tmp_path / "config.yaml"
    path.write_text("teacher: {source_candidates: 1, steps: 7}\n")
    assert yaml.safe_load(current(f"{option}{path}").removeprefix(option)) == {"teacher": {"steps": 7}}
    assert current(f"{option}{path}").startswith(option)
    path.write_text("teacher: {steps: 7}\n")
    assert current(f"{option}{path}") == f"{option}{path}"
