"""What a run warns of stays with it."""

import logging

from cli.table import told_warnings
from idapt_pl.run_folder import kept_warnings
from idapt_pl.run_folder.kept_warnings import WARNINGS, keeping_warnings, read_warnings

ours, others = logging.getLogger("idapt_pl.stages.labels"), logging.getLogger("lightning.pytorch")


def test_warnings_of_the_project_are_kept_once_the_newest_last(tmp_path):
    with keeping_warnings(tmp_path):
        ours.warning("begin exploring episodes anew, by schedule.exploration_horizon %d", 12)
        others.warning("of a library")
        ours.info("no warning")
        logging.getLogger("cli.fit").error("worse")
        ours.warning("begin exploring episodes anew, by schedule.exploration_horizon %d", 12)
    ours.warning("after the run")
    assert read_warnings(tmp_path) == ["worse", "begin exploring episodes anew, by schedule.exploration_horizon 12"]


def test_a_resumed_run_and_a_process_beside_it_add_to_what_is_there(tmp_path):
    with keeping_warnings(tmp_path), keeping_warnings(tmp_path):
        ours.warning("first")
    with keeping_warnings(tmp_path):
        ours.warning("second")
        ours.warning("first")
    assert read_warnings(tmp_path) == ["second", "first"]


def test_of_warnings_that_differ_in_numbers_alone_the_newest_is_kept(tmp_path):
    with keeping_warnings(tmp_path):
        ours.warning("head in %.0f%% of the frames; view {share: %g, up: %g}", 27, 0.66, -0.17)
        ours.warning("something else")
        ours.warning("head in %.0f%% of the frames; view {share: %g, up: %g}", 8, 0.7, 1)
        ours.warning("foot in %.0f%% of the frames; view {share: %g, up: %g}", 8, 0.7, 1)
    told = [f"{part} in 8% of the frames; view {{share: 0.7, up: 1}}" for part in ("head", "foot")]
    assert read_warnings(tmp_path) == ["something else", *told]


def test_a_run_without_warnings_has_no_file(tmp_path):
    with keeping_warnings(tmp_path):
        ours.info("all is well")
    assert read_warnings(tmp_path) == [] and not list(tmp_path.iterdir())


def test_a_run_goes_on_where_warnings_cannot_be_written(tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kept_warnings, "write_json", full)
    with keeping_warnings(tmp_path):
        ours.warning("nobody can keep this")
    assert read_warnings(tmp_path) == [] and "Traceback" not in capsys.readouterr().err


def test_a_damaged_file_is_told_and_ends_nothing(tmp_path):
    (tmp_path / WARNINGS).write_text("{")
    (said,) = told_warnings(tmp_path)
    assert WARNINGS in said
