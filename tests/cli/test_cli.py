"""The command line: every config parses; a user's mistake gets a short message and the right exit code."""

import json
import logging
import shutil
import subprocess
import sys

import pytest
from conftest import QUICK, ROOT

from cli.fit import GroundingCLI
from cli.main import COMMANDS, main, say_what_matters
from cli.provenance import claim
from datamodules import read_trajectories

CONFIGS = sorted(
    p for p in (ROOT / "configs").rglob("*.yaml") if not {"presets", "visual", "diagnose", "sweeps"} & set(p.parts)
)
PRESETS = sorted((ROOT / "configs" / "presets").glob("*.yaml"))


def run(args, capsys):
    """Exit code and what was printed, of a command run in this process."""
    try:
        code = main([str(a) for a in args])
    except SystemExit as end:  # argparse and jsonargparse leave this way
        code = end.code
    return code, capsys.readouterr()


def assert_short_error(code, printed, expected_code, *words):
    assert code == expected_code
    assert "Traceback" not in printed.err + printed.out
    message = " ".join(printed.err.split())
    assert 0 < len(message) < 1500
    for word in words:
        assert str(word) in message, message


# --- configs --------------------------------------------------------------------------------------------


def overlays():
    hard = ROOT / "configs" / "pendulum_hard.yaml"
    base = hard if hard.exists() else QUICK
    runner = ROOT / "configs" / "cheetah_hard.yaml"  # who goes backwards has a direction
    return [(c,) for c in CONFIGS] + [(runner if "backwards" in p.stem else base, p) for p in PRESETS]


@pytest.mark.parametrize("configs", overlays(), ids=lambda c: "+".join(p.stem for p in c))
def test_config_parses_and_its_modules_can_be_built(configs, tmp_path):
    args = [a for c in configs for a in ("--config", str(c))]
    cli = GroundingCLI([*args, "--run_dir", str(tmp_path / "run")])
    made = cli.run()
    dimensions, bounds = made.worlds.dimensions, made.worlds.action_bounds
    make = made.context.make
    P_S, policy = make.state_predictor(**dimensions), make.policy(**dimensions, **bounds)
    make.visual(**dimensions).adopt(P_S.P_S)
    policy.start_from(P_S.P_S)
    assert not made.folder.exists(), "building a run writes nothing"


def test_there_is_a_config_to_test():
    assert QUICK in CONFIGS


def test_overrides_on_the_command_line_win(tiny_args, tmp_path):
    cli = GroundingCLI(tiny_args(tmp_path, schedule__interactions=77, policy__gamma=0.5))
    assert cli.config.schedule.interactions == 77 and cli.config.policy.gamma == 0.5


# --- mistakes -------------------------------------------------------------------------------------------


def test_the_overview_does_not_wait_for_torch():
    code = "import sys; from cli.main import main; assert main(['--help']) == 0; assert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and "ground the source in the target" in done.stdout, done.stderr


def test_other_packages_say_no_more_than_what_a_user_can_do_something_about():
    """Lightning sets its level as it is imported, which is when a command begins."""
    code = (
        "import logging; from cli.main import main; assert main(['report', '--run', 'nowhere']) == 1; "
        "assert {logging.getLogger(n).level for n in ('lightning.pytorch', 'lightning.fabric')} == {logging.WARNING}; "
        "assert logging.getLogger().level == logging.INFO"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_usage_lists_every_command(capsys):
    code, printed = run(["--help"], capsys)
    assert code == 0 and all(name in printed.out for name in COMMANDS)
    assert run([], capsys)[0] == 2


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    code, printed = run([name, "--help"], capsys)
    assert code == 0 and f"idapt {name}" in printed.out


def test_unknown_command_is_bad_usage_and_lists_the_commands(capsys):
    assert_short_error(*run(["train"], capsys), 2, "unknown command 'train'", "fit", "collect")


def test_unknown_config_key_is_bad_usage_and_is_named(capsys):
    code, printed = run(["fit", "--config", QUICK, "--schedule.iterations", "3"], capsys)
    assert code == 2 and "iterations" in printed.err and "Traceback" not in printed.err


def test_unknown_key_in_a_config_file_is_bad_usage_and_is_named(tmp_path, capsys):
    config = tmp_path / "mine.yaml"
    config.write_text(QUICK.read_text() + "\nfriction: 3\n")
    code, printed = run(["fit", "--config", config], capsys)
    assert code == 2 and "friction" in printed.err and "Traceback" not in printed.err


def test_value_of_the_wrong_type_is_bad_usage_and_is_named(capsys):
    code, printed = run(["fit", "--config", QUICK, "--schedule.images", "many"], capsys)
    assert code == 2 and "schedule.images" in printed.err and "Traceback" not in printed.err


def test_a_seed_that_would_have_no_effect_is_an_error_that_names_the_one_that_has(capsys):
    result = run(["fit", "--config", QUICK, "--seed_everything", "3"], capsys)
    assert_short_error(*result, 1, "seed_everything", "--seed")


def test_missing_config_file_is_bad_usage_and_is_named(capsys):
    code, printed = run(["fit", "--config", "configs/pendulum_quik.yaml"], capsys)
    assert code == 2 and "pendulum_quik.yaml" in printed.err and "Traceback" not in printed.err


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--task", "pendulum"), ("pendulum", "inverted_pendulum")),
        (("--target", "harder"), ("harder", "easy, hard")),
    ],
)
def test_unknown_task_or_target_is_an_error_that_lists_the_known(option, words, tiny_args, tmp_path, capsys):
    code, printed = run(["fit", *tiny_args(tmp_path / "run"), *option], capsys)
    assert_short_error(code, printed, 1, *words)
    assert not (tmp_path / "run").exists()


def test_a_run_folder_that_another_process_is_at_work_in_is_left_alone(tiny_args, tmp_path, capsys):
    with claim(tmp_path / "run"):
        result = run(["fit", *tiny_args(tmp_path / "run")], capsys)
    assert_short_error(*result, 1, "another process is at work in", tmp_path / "run", "--run_dir")
    assert not (tmp_path / "run" / "config.yaml").exists()


def test_evaluating_what_is_no_run_folder_is_an_error_that_says_what_to_give(tmp_path, capsys):
    assert_short_error(*run(["evaluate", "--run", tmp_path / "nothing"], capsys), 1, tmp_path / "nothing", "idapt fit")


def test_evaluating_a_run_without_a_policy_says_how_to_resume_it(finished_run, tmp_path, capsys):
    (tmp_path / "config.yaml").write_text((finished_run / "config.yaml").read_text())
    assert_short_error(*run(["evaluate", "--run", tmp_path], capsys), 1, "no finished policy", "idapt fit --config")


def test_evaluate_without_a_run_is_bad_usage(capsys):
    assert_short_error(*run(["evaluate"], capsys), 2, "--run")


@pytest.mark.parametrize(
    ("wrong", "code", "words"),
    [
        (("--domain", "moon"), 1, ("moon", "source", "easy", "hard")),
        (("--task", "pendulum"), 1, ("pendulum", "inverted_pendulum")),
        (("--task", "dm_control:cartpole/nope"), 1, ("cartpole",)),
        (("--steps", "many"), 2, ("--steps", "many")),
        (("--task-options", "3"), 2, ("--task-options", "action_repeat")),
        (("--task-options", "{a: [}"), 2, ("--task-options", "YAML")),
        (("--task-options", "{a: 1}"), 1, ("task_options", "inverted_pendulum")),
    ],
)
def test_collect_lists_its_choices(wrong, code, words, tmp_path, capsys):
    args = {
        "--task": "inverted_pendulum",
        "--domain": "source",
        "--out": tmp_path / "d.h5",
        wrong[0]: wrong[1],
    }
    assert_short_error(*run(["collect", *(a for kv in args.items() for a in kv)], capsys), code, *words)


def test_collect_of_no_steps_is_an_error_and_writes_nothing(tmp_path, capsys):
    args = [
        "collect",
        "--task",
        "inverted_pendulum",
        "--domain",
        "source",
        "--steps",
        "0",
        "--out",
        tmp_path / "d.h5",
    ]
    assert_short_error(*run(args, capsys), 1, "--steps must be at least 1, got 0")
    assert list(tmp_path.iterdir()) == []


def test_installed_command_reports_a_mistake_without_a_traceback():
    """As a process, through the interpreter: what a user's shell sees."""
    program = "import sys; from cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "evaluate", "--run", "/nonexistent"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 1
    assert "/nonexistent is not a run folder" in result.stderr and "Traceback" not in result.stderr


# --- what the commands do -------------------------------------------------------------------------------


@pytest.mark.parametrize("domain", ["source", "hard"])
def test_collect_writes_a_trajectory_file_that_shows_the_target_as_images_and_actions(domain, tmp_path, capsys):
    out = tmp_path / "d.h5"
    args = [
        "collect",
        "--task",
        "inverted_pendulum",
        "--domain",
        domain,
        "--steps",
        "30",
        "--image-size",
        "16",
        "--out",
        out,
    ]
    code, printed = run(args, capsys)
    assert code == 0 and "30 steps" in printed.out
    data = read_trajectories(out)
    assert data.total_steps == 30 and data.dt == pytest.approx(0.04)
    for e in data:
        assert set(e.observations) == ({"pixels", "state"} if domain == "source" else {"pixels"})
        assert (e.rewards is None) == (domain != "source")


def test_collect_and_gallery_take_tasks_of_others(tmp_path, capsys):
    own = ["--task", "dm_control:cartpole/balance", "--task-options", "{action_repeat: 4, expert_steps: 64}"]
    size = ["--image-size", "24"]
    collect = ["collect", *own, *size, "--domain", "source", "--steps", "12", "--experts", tmp_path / "experts"]
    assert run([*collect, "--policy", "random+expert", "--out", tmp_path / "d.h5"], capsys)[0] == 0
    data = read_trajectories(tmp_path / "d.h5")
    assert data.total_steps == 12 and data.dt == pytest.approx(0.04) and "state" in data.episodes[0].observations
    assert json.loads(data.source)["task_options"] == {"action_repeat": 4, "expert_steps": 64}
    (kept,) = (tmp_path / "experts").iterdir()
    assert kept.name.startswith("dm_control_cartpole_balance_"), "a task's name may hold slashes"
    assert run(["gallery", *own, *size, "--out", tmp_path / "g"], capsys)[0] == 0
    assert "dm_control:cartpole/balance" in (tmp_path / "g/index.html").read_text()


def test_evaluate_reports_every_policy_of_a_run_and_leaves_the_methods_total_alone(finished_run, tmp_path, capsys):
    folder = shutil.copytree(finished_run, tmp_path / "run")
    before = json.loads((folder / "ledger.json").read_text())
    code, printed = run(["evaluate", "--run", folder, "--episodes", "2", "--json"], capsys)
    assert code == 0
    result = json.loads(printed.out[printed.out.index("{") :])
    assert len(result["policies"]) >= 3 and "direct transfer" in result["policies"]
    for returns in result["policies"].values():
        assert len(returns["target"]["returns"]) == 2
    after = json.loads((folder / "ledger.json").read_text())
    assert after["training_total"] == before["training_total"] and len(after["entries"]) > len(before["entries"])


def test_an_option_that_is_misspelt_is_guessed(capsys):
    with pytest.raises(SystemExit):
        main(["excite", "--model", "m.xml", "--report", "r", "--out", "o.csv", "--sede", "1"])
    assert "unrecognized arguments: --sede 1; did you mean --seed?" in capsys.readouterr().err


def test_what_nobody_can_do_anything_about_is_not_logged(caplog):
    say_what_matters()
    logging.getLogger("absl").warning("compiler attribute 'settotalmass' is deprecated and will be removed")
    logging.getLogger("absl").warning("the simulation is unstable")
    assert caplog.messages == ["the simulation is unstable"]
