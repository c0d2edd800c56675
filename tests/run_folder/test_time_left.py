"""How long the rest of a run takes: exact where costs are as expected, and corrected where a machine is slower."""

import json

import pytest
from conftest import TINY

from cli.fit import GroundingCLI
from cli.main import main
from idapt_pl.run_folder.time_left import EARLY, TimeLeft, expected_seconds, in_words

WORK = {(0, "visual"): 100.0, (0, "policy"): 50.0, (1, "policy"): 50.0}


def test_where_stages_cost_what_is_expected_the_rest_does_too():
    clock = TimeLeft(WORK)
    assert clock.done(0, "visual", 100.0) == pytest.approx(100)
    assert clock.done(0, "policy", 50.0) == pytest.approx(50)
    assert clock.done(1, "policy", 50.0) == 0


def test_on_a_machine_half_as_fast_the_rest_takes_nearly_twice_as_long():
    left = TimeLeft(WORK).done(0, "visual", 200.0)
    assert pytest.approx(left) == 100 * (EARLY * 200 + 200) / (EARLY * 200 + 100) and 150 < left < 200


def test_what_was_done_before_and_what_nobody_expected_say_nothing_about_the_speed():
    clock = TimeLeft(WORK)
    assert clock.done(0, "visual", None) == pytest.approx(100)
    assert clock.done(0, "something else", 1000.0) == pytest.approx(100)


@pytest.mark.parametrize(("seconds", "words"), [(40, "40 s"), (89, "89 s"), (600, "10 min"), (7200, "2.0 h")])
def test_words(seconds, words):
    assert in_words(seconds) == words


@pytest.mark.parametrize("name", ["pendulum_quick", "cheetah_quick", "fetch_quick", "walker_hard"])
def test_every_stage_of_a_config_is_expected(name):
    config = GroundingCLI(["--config", f"configs/{name}.yaml", "--side_by_side", "false"]).run().config
    costs = expected_seconds(config)
    steps = config.schedule.grounding_steps
    assert {(k, "visual") in costs for k in range(steps + 1)} == {True} or config.schedule.finetune.visual == 0
    assert ((0, "effects") in costs) == config.effects.discover
    assert ((0, "rehearsal_policy") in costs) == bool(config.teacher.rehearse)
    beside = expected_seconds(config, beside=True)
    assert beside.keys() < costs.keys() and (steps, "evaluation") in beside


def test_rounds_are_expected_of_the_last_teacher_of_a_step_alone():
    options = ["--config", "configs/cheetah_hard.yaml", "--side_by_side", "false", "--teacher.rounds", "3"]
    costs = expected_seconds(GroundingCLI(options).run().config)
    named = {(k, name) for k, name in costs if name.endswith(("_policy_2", "_policy_3"))}
    kinds = ("rehearsal", "estimator", "filter")
    expected = {(0, f"hardened_{kind}_policy_{i}") for kind in kinds for i in (2, 3)}
    assert named == expected | {(k, f"{kind}_policy_{i}") for k in (1, 2) for kind in kinds for i in (2, 3)}


def test_no_stage_of_a_run_comes_as_a_surprise(finished_run):
    config = GroundingCLI(["--config", str(finished_run / "config.yaml")]).run().config
    stages = {(e["step"], e["stage"]) for e in json.loads((finished_run / "summary.json").read_text())["stages"]}
    unexpected = {name for k, name in stages - expected_seconds(config).keys()}
    assert unexpected <= {"selection", "source_start", "policy", "source_policy"}, "these cost nothing by themselves"


def test_every_stage_tells_what_is_left(tmp_path, caplog):
    options = [f"--{k}={v}" for k, v in (TINY | {"schedule.grounding_steps": 0, "run_dir": tmp_path / "run"}).items()]
    with caplog.at_level("INFO"):
        assert main(["fit", "--config", "configs/pendulum_quick.yaml", *options]) == 0
    told = [line for line in caplog.messages if "left)" in line]
    assert told and all("about" in line for line in told)
