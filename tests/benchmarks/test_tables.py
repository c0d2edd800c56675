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


def walkers(folder, interactions, last):
    """Tables of one run of walker_hard with so many grounding steps, whose returns count up from 1."""
    (folder / "bounds.csv").write_text("task,domain,policy,metric,mean\nwalker2d,hard,oracle,return,10\n")
    rows = ["direct transfer,0,,1", "visual only,0,0,2", *(f"IDAPT,0,{k},{k + 2}" for k in range(1, last + 1))]
    (folder / "walker_hard.csv").write_text(
        "\n".join(["task,run,method,seed,grounding_step,mean,target_interactions",
                   *(f"walker2d,IDAPT,{row},{interactions}" for row in rows), ""])
    )  # fmt: skip
    return folder


def test_a_config_that_was_not_run_has_no_row(tmp_path):
    (line,) = tables.summary(walkers(tmp_path, 8000, 1)).splitlines()[2:]
    assert line == "| `walker_hard`, return | 1 | 8,000 | 1 | 2 | 3 | 10 | 1930 |"


def test_a_config_that_another_begins_with_has_its_first_steps(tmp_path):
    (line,) = tables.summary(walkers(tmp_path, 6000, 2), "quick").splitlines()[2:]
    assert line == "| `walker_quick`, return | 1 | 5,000 | 1 | 2 | 3 | 10 | 1930 |"


def test_a_config_that_another_begins_with_has_its_own_seeds_besides(tmp_path):
    head = (walkers(tmp_path, 6000, 2) / "walker_hard.csv").read_text().splitlines()[0]
    own = [f"walker2d,IDAPT,{row},5000" for row in ("direct transfer,0,,10", "visual only,0,0,20", "IDAPT,0,1,30")]
    other = [f"walker2d,IDAPT,{row},5000" for row in ("direct transfer,7,,10", "visual only,7,0,20", "IDAPT,7,1,30")]
    (tmp_path / "walker_quick.csv").write_text("\n".join([head, *other, ""]))
    (line,) = tables.summary(tmp_path, "quick").splitlines()[2:]
    assert line == "| `walker_quick`, return | 2 | 5,000 | 1, 10 | 2, 20 | 3, 30 | 10 | 1930 |"
    (tmp_path / "walker_quick.csv").write_text("\n".join([head, *own, ""]))
    (line,) = tables.summary(tmp_path, "quick").splitlines()[2:]
    assert line == "| `walker_quick`, return | 1 | 5,000 | 10 | 20 | 30 | 10 | 1930 |", "a seed counts once"


def test_baselines_stand_beside_what_the_paper_has(tmp_path):
    measured = [("oracle", 0, 1000, 0, 12500), ("dr_wide", 1, 30, 0, 0), ("dr_wide", 0, 20, 0, 0),
                ("dr_wide", 2, 40, 0, 0), ("dr_narrow", 0, 7, 0, 0)]  # fmt: skip
    rows = [f"quick,inverted_pendulum,hard,{m},{seed},return,{x},{n},{o},abcdef012" for m, seed, x, n, o in measured]
    head = "config,task,target,method,seed,metric,mean,target_interactions,reference_interactions,commit"
    (tmp_path / "baselines.csv").write_text("\n".join([head, *rows, ""]))
    oracle, wide, narrow = tables.baselines(tmp_path).splitlines()[2:]
    assert oracle == "| `quick` | `oracle` | 0 | 1000 | 12,500 of the oracle |  | abcdef0 |"
    assert wide == "| `quick` | `dr_wide` | 0 1 2 | 30 ± 25 | 0 | 124 | abcdef0 |"
    assert narrow == "| `quick` | `dr_narrow` | 0 | 7 | 0 |  | abcdef0 |"


def test_each_version_of_a_pair_of_worlds_has_a_row_beside_its_target_s_oracle(tmp_path):
    measured = [("IDAPT", 0, "", 1), ("IDAPT", 0, 0, 2), ("IDAPT", 0, 1, 3), ("IDAPT", 1, "", 5), ("IDAPT", 1, 0, 6),
                ("IDAPT", 1, 2, 7), ("first", 2, "", 8), ("first", 2, 0, 9), ("oracle", 0, "", 10)]  # fmt: skip
    rows = [f"lab:Arm,Bench,{run},{run},{seed},{k},{mean},5000,abcdef012" for run, seed, k, mean in measured]
    head = "task,target,run,method,seed,grounding_step,mean,target_interactions,commit"
    (tmp_path / "own_targets.csv").write_text("\n".join([head, *rows, ""]))
    now, first = tables.own_worlds(tmp_path).splitlines()[2:]
    assert now == "| `Arm` | Bench | IDAPT | 0 1 | 5,000 | 1, 5 | 2, 6 | 3, 7 | 10 | abcdef0 |"
    assert first == "| `Arm` | Bench | first | 2 | 5,000 | 8 | 9 |  | 10 | abcdef0 |"


def test_further_recordings_are_counted_where_the_first_left_something_open(tmp_path):
    rows = ["a,0,4,none,named,0,", "b,0,4,excite,named,1,8 0.001", "b,0,4,random,named,3,4 0.001"]
    rows += ["c,0,4,excite,inseparable,0,0.5", "c,0,4,random,open,3,0.4"]
    rows += ["c,0,2,excite,wrong,2,6", "c,0,2,random,named,1,6"]  # a shorter motion is another recording
    head = "case,seed,duration,method,outcome,recordings,separation"
    (tmp_path / "excitation.csv").write_text("\n".join([head, *rows, ""]))
    ours, random = tables.next_recordings(tmp_path).splitlines()[2:]
    assert ours == "| excite | 1 of 3 | 1 of 3 | 1 of 3 | 1 | 0 | 1 | 1.0 |"
    assert random == "| random | 1 of 3 | 1 of 3 | 2 of 3 | 0 | 1 | 0 | 2.5 |"


@pytest.mark.parametrize("name", tables.FIRST_STEPS)
def test_such_configs_differ_in_the_number_of_steps_alone(name):
    longer, steps, interactions = tables.FIRST_STEPS[name]
    short, long = (yaml.safe_load((CONFIGS / f"{c}.yaml").read_text()) for c in (name, longer))
    schedule = short["schedule"]
    assert schedule["images"] + steps * schedule["interactions"] == interactions
    assert schedule.pop("grounding_steps") == steps and long["schedule"].pop("grounding_steps") >= steps
    assert short == long


def test_what_two_models_differ_by_stands_beside_what_was_found(tmp_path):
    head = "seed,effect,target,parameter,nominal,estimate,low,high,truth"
    rows = ("0,joint_range,foot,lower,-0.4,-0.62,-13,-0.62,-4.0", "1,joint_range,foot,lower,,,,,-4.0",
            "1,body_mass,leg,mass,1.5,1.7,1.6,1.8,")  # fmt: skip
    (tmp_path / "two_models.csv").write_text("\n".join([head, *rows, ""]))
    foot, leg = tables.two_models(tmp_path).splitlines()[2:]
    assert foot == "| `joint_range` of `foot`, lower | -0.4 | -4.0 | -0.62 | not named |"
    assert leg == "| `body_mass` of `leg`, mass | 1.5 | as in the model | not named | 1.7 |"
