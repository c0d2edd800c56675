"""The tables of the pages: which of a run's policies stands in which column."""

from pathlib import Path

import pytest
import yaml

from benchmarks import tables

CONFIGS = Path(__file__).parents[2] / "configs"


def row(seed, step, mean, method="IDAPT"):
    return {"seed": seed, "grounding_step": step, "mean": mean, "method": method}


def test_the_last_step_of_every_seed_counts_however_many_there_were():
    rows = [row(0, "", 1), row(0, "0", 2), row(0, "1", 3), row(0, "2", 4), row(0, "10", 5), row(0, "", 99, "oracle"),
            row(1, "", 6), row(1, "0", 7), row(1, "1", 8)]  # fmt: skip
    assert tables.by_stage(rows) == [[1, 6], [2, 7], [5, 8]]


def test_a_run_of_step_0_alone_has_no_last_step():
    assert tables.by_stage([row(0, "", 1), row(0, "0", 2)]) == [[1], [2], []]


def test_a_config_that_was_not_run_has_no_row(tmp_path):
    (tmp_path / "bounds.csv").write_text("task,domain,policy,metric,mean\nwalker2d,hard,oracle,return,10\n")
    (tmp_path / "walker_hard.csv").write_text(
        "task,run,method,seed,grounding_step,mean,target_interactions\n"
        "walker2d,IDAPT,direct transfer,0,,1,8000\nwalker2d,IDAPT,visual only,0,0,2,8000\n"
        "walker2d,IDAPT,IDAPT,0,1,3,8000\n"
    )
    (line,) = tables.summary(tmp_path).splitlines()[2:]
    assert line == "| `walker_hard`, return | 1 | 8,000 | 1 | 2 | 3 | 10 | 1930 |"


def test_a_config_that_another_begins_with_has_its_first_steps(tmp_path):
    (tmp_path / "bounds.csv").write_text("task,domain,policy,metric,mean\nwalker2d,hard,oracle,return,10\n")
    (tmp_path / "walker_hard.csv").write_text(
        "task,run,method,seed,grounding_step,mean,target_interactions\n"
        "walker2d,IDAPT,direct transfer,0,,1,6000\nwalker2d,IDAPT,visual only,0,0,2,6000\n"
        "walker2d,IDAPT,IDAPT,0,1,3,6000\nwalker2d,IDAPT,IDAPT,0,2,4,6000\n"
    )
    (line,) = tables.summary(tmp_path, "quick").splitlines()[2:]
    assert line == "| `walker_quick`, return | 1 | 5,000 | 1 | 2 | 3 | 10 | 1930 |"


@pytest.mark.parametrize("name", tables.FIRST_STEPS)
def test_such_configs_differ_in_the_number_of_steps_alone(name):
    longer, steps, interactions = tables.FIRST_STEPS[name]
    short, long = (yaml.safe_load((CONFIGS / f"{c}.yaml").read_text()) for c in (name, longer))
    schedule = short["schedule"]
    assert schedule["images"] + steps * schedule["interactions"] == interactions
    assert schedule.pop("grounding_steps") == steps and long["schedule"].pop("grounding_steps") >= steps
    assert short == long
