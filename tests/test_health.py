# ruff: noqa: E501 (a table)
"""Numbers that are none stop a stage before anything is kept; losses that run away are noted; healthy ones are not."""

import json
import math

import pytest
import torch
from torch import nn

from cli.main import main
from idapt_pl.health import FEWEST_VALUES, Health, NotFinite, check_weights, early_and_late, worth

BROKEN = {
    "state_predictor": ("state_predictor__lr", {"schedule__pretrain__state_predictor": 60}, "step_00/state_predictor"),
    "policy": ("policy__lr", {"schedule__source_policy": 200}, "step_00/source_policy"),
    "visual": ("visual__lr_generator", {"schedule__pretrain__visual": 40, "schedule__source_policy": 0}, "step_00/visual"),
    "dynamics": ("dynamics__lr", {"schedule__finetune__dynamics": 10, "schedule__grounding_steps": 1}, "step_01/dynamics"),
}  # fmt: skip


@pytest.mark.parametrize("module", BROKEN)
def test_a_module_that_breaks_is_not_kept_and_the_setting_is_named(module, tiny_args, tmp_path, capsys):
    key, changes, stage = BROKEN[module]
    code = main(["fit", *tiny_args(tmp_path / "run", **changes | {key: 1e30})])
    said = capsys.readouterr().err.splitlines()[-1]
    assert code == 1 and not (tmp_path / "run" / stage / "final.ckpt").exists()
    assert not (tmp_path / "run" / "summary.json").exists()
    assert f"stage {stage.split('/')[1]}: " in said and f"{key.replace('__', '.')} (now 1e+30)" in said


def test_a_healthy_run_says_nothing_of_it(finished_run):
    told = [json.loads(path.read_text()) for path in finished_run.glob("step_*/*/stage.json")]
    assert len(told) > 5 and not any("ran_away" in stage for stage in told)


def test_values_beyond_what_rewards_are_worth_are_noted_and_shown(tiny_args, tmp_path):
    run = tmp_path / "run"
    changes = {"schedule__source_policy": 100, "schedule__grounding_steps": 0, "policy__lr": 1e4}
    assert main(["fit", *tiny_args(run, **changes)]) == 0
    (words,) = json.loads((run / "step_00/source_policy/stage.json").read_text())["ran_away"]
    assert words.startswith("policy/q ended at ")
    assert "Training ran away, look at its curves. Stage source_policy: policy/q" in (run / "report.html").read_text()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_one_bad_weight_is_found(bad):
    net = nn.Linear(3, 3)
    check_weights(net, "here", "do this")
    net.weight.data[1, 1] = bad
    with pytest.raises(NotFinite, match=r"^here: 1 of 2 tensors of weights are not finite, first weight, .* do this$"):
        check_weights(net, "here", "do this")


def ran_away(values, name="visual/cycle"):
    health = Health("a stage")
    health.seen[name] = values
    return health.running_away(nn.Linear(1, 1), None)


HEALTHY = {
    "falls": [10 * 0.97**i for i in range(200)],
    "doubles": [0.5 + 0.003 * i for i in range(200)],
    "swings": [0.4 + 0.3 * math.sin(i) for i in range(200)],
    "begins at nothing": [0.001] * 100 + [0.4] * 100,  # a discriminator that lost its lead
    "one peak": [0.5] * 195 + [900] + [0.5] * 4,
    "short": [1.0] * (FEWEST_VALUES - 2) + [500.0],
}
SICK = {
    "grows": [0.5 * 1.05**i for i in range(200)],
    "jumps": [0.5] * 100 + [20.0] * 100,
    "was far off at once": [1e6] * 200,
}


@pytest.mark.parametrize("series", HEALTHY)
def test_healthy_losses_raise_no_alarm(series):
    assert ran_away(HEALTHY[series]) == []


@pytest.mark.parametrize("series", SICK)
def test_losses_that_run_away_are_noted(series, caplog):
    (words,) = ran_away(SICK[series])
    assert words.startswith("visual/cycle ended at ") and words in caplog.text


@pytest.mark.parametrize("name", ["visual/g_target", "visual/d_target", "dynamics/discriminator"])
def test_networks_of_every_stage_are_watched(name):
    (words,) = ran_away(SICK["grows"], name)
    assert words.startswith(f"{name} ended at ")


def test_critics_losses_may_grow_with_the_values():
    assert ran_away([1.05**i for i in range(200)], "policy/critic_loss") == []


def test_early_is_the_first_quarter_and_late_the_last_tenth():
    assert early_and_late({"x": [*range(40)]}) == {"x": (4.5, 37.5)}


def test_a_reward_forever_is_worth_its_sum():
    assert worth({"gamma": 0.9}, torch.tensor([-2.0, 1.0])) == pytest.approx(30)
