"""Scores, tables and the page of a sweep, from run folders as ``idapt fit`` leaves them."""

import csv
import json

import numpy as np
import pytest

from idapt_pl.evaluation.paper import PAPER_RESULTS, unlike_the_paper
from idapt_pl.sweep.estimate import expected_minutes, minutes_to_the_end
from idapt_pl.sweep.folder import DONE, FAILED, WAITING, RunStatus, SweepFolder
from idapt_pl.sweep.plan import PlannedRun
from idapt_pl.sweep.report import write_sweep_report
from idapt_pl.sweep.results import by_cell, cell_scale, method_scores, read_results
from idapt_pl.sweep.settings import settings_from
from idapt_pl.sweep.summaries import cell_rows, improvement_rows, overall_rows
from idapt_pl.sweep.table import counts, failed_lines, read_progress

RETURNS = {
    ("inverted_pendulum", "hard", "IDAPT"): ([10, 14], [1000, 900], None),
    ("inverted_pendulum", "hard", "no F"): ([10, 14], [500, 12], None),
    ("half_cheetah", "hard", "IDAPT"): ([100, 300], [2200, 2600], 3200),
    ("half_cheetah", "hard", "no F"): ([100, 300], [1700, 200], 3200),
    ("fetch_reach", "easy", "IDAPT"): ([1.0, 1.0], [1.0, 1.0], 1.0),
    ("fetch_reach", "easy", "no F"): ([1.0, 1.0], [1.0, 1.0], None),
}
"""Cell and method to direct transfer and last return of each seed, and the oracle."""


def settings(**changes):
    said = {"tasks": ["inverted_pendulum"], "targets": ["hard"], "methods": {"IDAPT": {}, "no F": {}}, "seeds": [0, 1]}
    return settings_from(said | changes, None)


@pytest.fixture
def sweep(tmp_path):
    """A sweep's folder with two runs for each entry above, and their statuses."""
    folder, runs = SweepFolder(tmp_path / "sweep"), []
    for (task, target, method), (direct, last, oracle) in RETURNS.items():
        for seed in range(2):
            name = f"{task}_{target}_{method.replace(' ', '-')}_{seed}"
            run = PlannedRun(len(runs), name, task, task, target, method, seed)
            summary = {
                "metric": "success" if task == "fetch_reach" else "return", "episodes": 20,
                "direct_transfer": direct[seed], "oracle": oracle, "visual_only": 50.0, "grounded": [last[seed]],
                "target_interactions": 6000, "wall_s": 600.0 + 60 * seed, "method": "idapt", "result": last[seed],
            }  # fmt: skip
            folder.run(name).mkdir(parents=True)
            (folder.run(name) / "summary.json").write_text(json.dumps(summary))
            (folder.run(name) / "run.json").write_text(json.dumps({"git_commit": "abcdef0123+dirty", "cpu": "EPYC"}))
            folder.write_status(name, RunStatus(DONE, [], "node1"))
            runs.append(run)
    return folder, runs


def statuses_of(folder, runs):
    return {run: folder.status(run.name) for run in runs}


def test_scores_are_0_at_direct_transfer_and_1_at_the_reference(sweep):
    folder, runs = sweep
    cells = by_cell(read_results(runs, statuses_of(folder, runs), folder))
    pendulum = cell_scale(cells["inverted_pendulum/hard"], settings())
    assert (pendulum.zero, pendulum.one) == (12, 1000) and pendulum.one_from == "IDAPT in the paper"
    assert pendulum.zero_from == "mean of 4 runs" and pendulum.scores(np.array([12.0, 1000.0])) == pytest.approx([0, 1])
    cheetah = cell_scale(cells["half_cheetah/hard"], settings())
    assert (cheetah.zero, cheetah.one, cheetah.one_from) == (200, 3200, "oracle, mean of 4 runs")
    assert cell_scale(cells["half_cheetah/hard"], settings(normalise="paper")).one == 1695
    given = settings(references={"half_cheetah/hard": {"direct_transfer": 0, "oracle": 2000}})
    scale = cell_scale(cells["half_cheetah/hard"], given)
    assert (scale.zero, scale.one) == (0, 2000) and "references" in scale.zero_from and "references" in scale.one_from
    assert "direct transfer has 1 already" in cell_scale(cells["fetch_reach/easy"], settings()).missing


def other_run(sweep, index, name, seed, config, **summary):
    """A run of a method without grounding steps beside those of the sweep."""
    folder, runs = sweep
    run = PlannedRun(index, f"half_cheetah_hard_{name}_{seed}", "half_cheetah", "half_cheetah", "hard", name, seed)
    told = json.loads((folder.run(runs[4].name) / "summary.json").read_text())
    folder.run(run.name).mkdir(parents=True)
    told |= {"visual_only": None, "grounded": [], "oracle": None, "target_interactions": 0} | summary
    (folder.run(run.name) / "summary.json").write_text(json.dumps(told))
    (folder.run(run.name) / "run.json").write_text(json.dumps({"config": config}))
    folder.write_status(run.name, RunStatus(DONE, [], "node1"))
    return run


def test_methods_without_grounding_steps_have_results_and_do_not_move_the_scale(sweep):
    folder, runs = sweep
    mine = runs[4:8]  # HalfCheetah's: direct transfer 100 and 300
    wide = {"randomisation": {"ranges": "wide"}}
    others = [
        other_run(sweep, 20, "DR-Wide", 0, wide, method="source", result=2700.0, direct_transfer=2700.0),
        other_run(sweep, 21, "plain", 0, {}, method="source", result=900.0, direct_transfer=900.0),
        other_run(sweep, 22, "oracle", 0, {}, method="oracle", result=3200.0, oracle=3200.0, direct_transfer=None),
    ]
    entries = [
        {"step": 0, "purpose": "oracle reference", "count": 70},
        {"step": 0, "purpose": "evaluation", "count": 9},
    ]
    (folder.run(others[2].name) / "ledger.json").write_text(json.dumps({"entries": entries}))
    results = read_results([*mine, *others], statuses_of(folder, [*mine, *others]), folder)
    dr, plain, oracle = results[4:]
    assert (dr.last, dr.step_0, dr.direct_transfer, dr.target_steps) == (2700, None, None, 0)
    assert (plain.last, plain.direct_transfer) == (900, 900)
    assert (oracle.last, oracle.target_steps) == (3200, 70)
    assert cell_scale(results, settings()).zero == 200, "of the policies that IDAPT's runs begin with"
    scores = method_scores(results, settings())
    assert scores.cells == ["half_cheetah/hard"] and scores.scores["DR-Wide"][0] == pytest.approx([2500 / 3000])
    assert read_progress(others, folder).results[others[0]] == 2700
    rows = {r["method"]: r for r in cell_rows(results, settings()) if r["source"] != "paper"}
    assert rows["DR-Wide"]["last"] == 2700 and rows["DR-Wide"]["step_0"] is None
    write_sweep_report([*mine, *others], statuses_of(folder, [*mine, *others]), folder, settings())


def test_scores_over_all_cells_are_of_the_cells_that_have_a_scale(sweep):
    folder, runs = sweep
    results = read_results(runs, statuses_of(folder, runs), folder)
    scores = method_scores(results, settings())
    assert scores.cells == ["inverted_pendulum/hard", "half_cheetah/hard"] and list(scores.left_out) == [
        "fetch_reach/easy"
    ]
    idapt = [(1000 - 12) / 988, (900 - 12) / 988, (2200 - 200) / 3000, (2600 - 200) / 3000]
    assert np.concatenate(scores.scores["IDAPT"]) == pytest.approx(idapt)
    first, second = overall_rows(scores)
    assert first["method"] == "IDAPT" and first["runs"] == 4 and first["mean"] == pytest.approx(np.mean(idapt))
    assert (
        first["iqm"] == pytest.approx(np.mean(sorted(idapt)[1:3]))
        and first["iqm_low"] < first["iqm"] < first["iqm_high"]
    )
    assert second["iqm"] < first["iqm"]
    (pair,) = improvement_rows(scores)
    assert (pair["first"], pair["second"], pair["probability"]) == ("IDAPT", "no F", 1.0)


def test_a_cell_in_which_a_method_is_missing_is_left_out_and_one_seed_has_no_interval(sweep):
    folder, runs = sweep
    some = [r for r in runs if r.seed == 0 and (r.task, r.method) != ("half_cheetah", "no F")]
    scores = method_scores(read_results(some, statuses_of(folder, some), folder), settings())
    assert scores.cells == ["inverted_pendulum/hard"]
    assert scores.left_out["half_cheetah/hard"] == "no run of no F is done"
    assert overall_rows(scores)[0]["iqm_low"] is None and overall_rows(scores)[0]["iqm"] == 1


def test_the_papers_figures_stand_beside_ours_with_what_differs(sweep):
    folder, runs = sweep
    rows = cell_rows(read_results(runs, statuses_of(folder, runs), folder), settings())
    paper = {r["cell"]: r for r in rows if r["source"] == "paper"}
    assert paper["half_cheetah/hard"]["last"] == 1695 and paper["half_cheetah/hard"]["score"] == pytest.approx(
        0.498, abs=1e-3
    )
    assert "25,000 target steps there, 6,000 here" in paper["half_cheetah/hard"]["note"]
    assert "Unity" in "".join(unlike_the_paper("sawyer_push", "hard", "IDAPT", 25_000))
    assert unlike_the_paper("walker2d", "easy", "DR-Wide", 0) == ["read off a figure, ± 10"]
    assert unlike_the_paper("walker2d", "easy", "IDAPT", 21_000) == ["read off a figure, ± 10"]
    assert "55,000 target steps there, 6,000 here" in unlike_the_paper("walker2d", "hard", "CC-State", 6000)
    tasks = {task for task, _ in PAPER_RESULTS}
    assert set(PAPER_RESULTS) == {(task, target) for task in tasks for target in ("easy", "hard")} and len(tasks) == 5


def test_the_page_has_everything_and_needs_nothing(sweep):
    folder, runs = sweep
    failed = PlannedRun(len(runs), "walker2d_hard_IDAPT_0", "walker2d", "walker2d", "hard", "IDAPT", 0)
    failure = {"code": 1, "host": "node2", "began": "now", "seconds": 3, "lines": ["idapt fit: out of <memory>"]}
    folder.write_status(failed.name, RunStatus(FAILED, [failure, failure], "node2"))
    every = [*runs, failed]
    page = write_sweep_report(every, statuses_of(folder, every), folder, settings())
    text = page.read_text()
    assert page == folder.path / "report.html" and "<script" not in text
    assert "http" not in text.replace("http://www.w3.org", ""), "nothing is fetched"
    for words in (
        "IDAPT: 0.", "12 of 13", "idapt fit: out of &lt;memory&gt;", "failed for good", "fetch_reach/easy is left out",
        "Score 0 is 12 (direct transfer, mean of 4 runs), 1 is 1000 (IDAPT in the paper)", "IDAPT in the paper *",
        "not like for like", "Probability of improvement", "abcdef0+",
    ):  # fmt: skip
        assert words in text, words
    assert text.count("<svg") == 3
    names = {p.name for p in folder.path.glob("*/*.csv")} | {p.name for p in folder.path.glob("figures/*")}
    assert names == {"runs.csv", "cells.csv", "scores.csv", "improvement.csv", "profiles.csv"} | {
        "cells.svg", "scores.svg", "profiles.svg"}  # fmt: skip
    with (folder.path / "tables/runs.csv").open() as f:
        rows = list(csv.DictReader(f))
    assert len(rows) == 12 and rows[4]["last"] == "2200" and rows[4]["commit"] == "abcdef0123+dirty"
    again = write_sweep_report(every, statuses_of(folder, every), folder, settings(), folder.path / "other.html")
    assert again.read_text() == text, "the same results make the same page"


def test_a_sweep_of_which_nothing_is_done_has_a_page_too(tmp_path):
    folder, run = SweepFolder(tmp_path), PlannedRun(0, "r", "a", "a", "hard", "IDAPT", 0)
    text = write_sweep_report([run], {run: RunStatus()}, folder, settings()).read_text()
    assert "0 of 1 runs are done" in text and "There are no scores yet" in text


def test_the_rest_is_estimated_from_runs_that_are_alike(sweep):
    folder, runs = sweep
    known = {run: 10.0 + run.seed for run in runs if run.task != "fetch_reach"} | {runs[0]: 20.0}
    other_seed = PlannedRun(99, "x", "inverted_pendulum", "inverted_pendulum", "hard", "IDAPT", 7)
    assert expected_minutes(other_seed, known) == (20 + 11) / 2
    other_target = PlannedRun(99, "x", "inverted_pendulum", "inverted_pendulum", "easy", "no F", 7)
    assert expected_minutes(other_target, known) == (10 + 11) / 2
    assert expected_minutes(runs[-1], known) is None
    assert minutes_to_the_end([3, 1, 1, 1], 2) == 3 and minutes_to_the_end([1, 1, 3], 2) == 4
    folder.write_status(runs[0].name, RunStatus(WAITING))
    folder.write_status(runs[1].name, RunStatus(WAITING, []))
    progress = read_progress(runs, folder)
    told = counts(progress, 2)
    assert told.startswith("12 runs: 10 done, 2 waiting. About 10 min with 2 side by side"), told
    assert progress.results[runs[4]] == 2200 and progress.minutes[runs[5]] == 11


def test_failures_are_listed_with_their_last_lines(tmp_path):
    folder, run = SweepFolder(tmp_path), PlannedRun(0, "r", "a", "a", "hard", "IDAPT", 0)
    failure = {"code": 1, "host": "node2", "lines": ["first", "idapt fit: full"]}
    lines = failed_lines({run: RunStatus(FAILED, [failure, failure], "node2")}, folder)
    assert lines[0] == "r failed 2 times, last with exit code 1 on node2:" and lines[2].strip() == "idapt fit: full"
    assert str(folder.log("r")) in lines[-1]
