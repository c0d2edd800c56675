import pytest

from benchmarks import taken_away
from cli.fit import GroundingCLI
from idapt_pl.report.run_record import ORDER

WITHOUT = {
    "rounds": {"hardened_filter_policy_2", "policy", "evaluation"},
    "hardening": {"hardened_filter_policy_2", "hardened_teacher", "policy", "evaluation"},
    "labels": {"hardened_filter_policy_2", "hardened_teacher", "filter_policy", "labelled", "policy", "evaluation"},
    "effects": {
        "hardened_filter_policy_2", "hardened_teacher", "filter_policy", "labelled", "teacher_2", "known_start_search",
        "policy", "evaluation",
    },
}  # fmt: skip
STAGES = (*ORDER, "teacher_2", "hardened_filter_policy_2")


@pytest.fixture
def run(tmp_path):
    """A folder with a file for every stage of two steps."""
    for k in (0, 1):
        (tmp_path / f"run/step_{k:02d}").mkdir(parents=True)
        for stage in STAGES:
            (tmp_path / f"run/step_{k:02d}/{stage}.json").write_text("{}")
    (tmp_path / "run/ledger.json").write_text("{}")
    return tmp_path / "run"


@pytest.mark.parametrize("part", taken_away.PARTS)
def test_a_fork_makes_again_what_its_part_has_a_say_in(run, part):
    fork = taken_away.fork(run, part)
    kept = {p.stem for p in fork.glob("step_00/*.json")}
    assert {"target", "source", "visual", "translated", "source_teacher", "state_predictor"} <= kept
    assert not kept & WITHOUT.get(part, {"policy", "evaluation", "rehearsal_policy"})
    assert {p.name for p in fork.iterdir()} == {"step_00"}, "what later steps saw of the target is not known yet"


def test_more_parts_gone_mean_more_is_made_again(run):
    kept = {part: {p.stem for p in taken_away.fork(run, part).glob("step_00/*")} for part in WITHOUT}
    assert kept["effects"] < kept["labels"] < kept["hardening"] < kept["rounds"] < set(STAGES)
    assert "hardened_filter_policy" in kept["rounds"] and "teacher_trials" in kept["labels"]


def test_a_fork_that_is_there_stays_as_it_is(run):
    fork = taken_away.fork(run, "labels")
    (fork / "step_00/labelled.json").write_text("made since")
    assert taken_away.fork(run, "labels") == fork and (fork / "step_00/labelled.json").exists()


@pytest.mark.parametrize("config", ["cheetah_hard", "walker_hard"])
@pytest.mark.parametrize("part", taken_away.PARTS)
def test_a_run_without_a_part_is_one_that_can_be_made(part, config, tmp_path):
    """Nothing that is left contradicts what is taken away."""
    options = ["--config", f"configs/{config}.yaml", *taken_away.without(part), f"--run_dir={tmp_path / 'run'}"]
    run = GroundingCLI(options).run()
    assert run.config.schedule.grounding_steps == 0 and run.method is not None
