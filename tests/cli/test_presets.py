"""A preset laid over any config gives what its name says: every value here is the paper's or its authors' code's."""

import pytest
import yaml
from conftest import QUICK, ROOT, TINY

from cli.fit import GroundingCLI
from cli.main import main
from idapt_pl.run_config import RunConfig
from idapt_pl.stages.distillation import TeacherSettings
from idapt_pl.stages.schedule import Schedule, StageLengths

CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
PAPER = {
    # Appendix: Policy Training
    "image_size": 100, "vision.crop": 92, "frame_stack": 3, "policy.hidden": [1024, 1024], "policy.encoder": "learned",
    "vision.strides": [2, 1, 1, 1], "vision.pool": "flatten", "vision.rates": "learned",
    # Table II; and no costs, noise, teacher or choice of policies beside them
    "policy.lr": 3e-4, "policy.lr_floor": 0.0, "feeding.policy_batch": 32, "feeding.updates_per_step": 10,
    "policy.gamma": 0.99, "policy.temperature": 0.001, "policy.learn_temperature": False, "policy.action_cost": 0.0,
    "policy.unfamiliarity_cost": 0.0, "policy.misperception": 0.0, "policy.flicker": 0.0,
    "teacher.steps": 0, "teacher.adapt": 0, "teacher.dagger": 0, "feeding.trial_episodes": 0,
    "feeding.trial_repeats": 0,
    # Appendix: Visual Transformation; equation 2
    "state_predictor.lr": 3e-4, "schedule.pretrain.state_predictor": 40 * 20_000 // 32,
    "schedule.pretrain.visual": 40 * 20_000 // 8, "schedule.finetune.state_predictor": 160,
    "schedule.finetune.visual": 5 * 1000 // 8, "schedule.pretrain.estimator": 0, "schedule.finetune.estimator": 0,
    "visual.finetune_convs": 1, "visual.state_jitter": 0.0, "visual.reset_weight": 0.0,
    # CycleGAN (Zhu et al. 2017, sec. 4 and 7), whose networks and settings the paper takes
    "visual.width": 64, "visual.blocks": 9, "visual.background": False, "visual.discriminator_width": 64,
    "visual.discriminator_layers": 3, "visual.gan_loss": "lsgan", "visual.pool_size": 50, "visual.cycle_weight": 10.0,
    "visual.identity_weight": 5.0, "visual.contrastive_weight": 0.0, "visual.consistency_weight": 0.0,
    "visual.ema_decay": 0.0, "visual.lr_generator": 2e-4, "visual.lr_discriminator": 2e-4, "visual.betas": [0.5, 0.999],
    # Table III; Appendix: Action Transformation
    "feeding.garat_rollout": 5000, "dynamics.lr": 3e-4, "dynamics.batch_size": 32, "dynamics.epochs": 5,
    "dynamics.gamma": 0.5, "dynamics.entropy_weight": 1e-3, "dynamics.clip": 0.1, "dynamics.hidden": [1024, 1024],
    "dynamics.smoothing": 0.95, "schedule.finetune.dynamics": 10, "feeding.garat_exploring": 0.0,
    "feeding.garat_start": "identity",
    # Section V-B; Fig. 4 (100 episodes); Appendix: Accumulating Data (not done by default)
    "schedule.images": 20_000, "schedule.source_images": None, "schedule.interactions": 1000, "episodes": 100,
    "schedule.accumulate": False, "schedule.action_transformation": True,
    "schedule.rollback": False, "schedule.until_settled": False,
    "schedule.exploration_horizon": None, "schedule.exploration_strays": 0.0, "schedule.paired_steps": 0,
    "schedule.repaired_visual": 0,
    "labels.members": 0, "labels.replays": 0, "effects.discover": False, "effects.looks": False,
    "view.share": 1.0, "view.up": 0.0, "view.right": 0.0, "poses.spread": 0,
    "effects.known": None, "randomisation.ranges": None,
    # Open in the paper, from the authors' code
    "feeding.visual_batch": 8, "feeding.buffer_size": 100_000, "visual.state_weight": 5.0, "policy.tau": 0.01,
}  # fmt: skip
OFFICIAL = PAPER | {
    # SAC: batch, one step of the critics a step, a learned temperature from 0.1, constant rates
    "feeding.policy_batch": 256, "feeding.updates_per_step": 1, "policy.learn_temperature": True,
    "policy.temperature": 0.1, "policy.lr_floor": 1.0, "policy.actor_every": 2,
    # visual: batches of 8 for P^S too, nine channels, smoothed labels, L1 on 0..255, rates, two convolutions
    "feeding.state_predictor_batch": 8, "schedule.pretrain.state_predictor": 40 * 2500,
    "schedule.finetune.state_predictor": 5 * 125, "visual.translate": "stack", "visual.blocks": 6,
    "visual.gan_loss": "bce", "visual.pool_size": 0, "visual.cycle_weight": 127.5, "visual.identity_weight": 0.0,
    "visual.lr_generator": 1e-4, "visual.lr_discriminator": 4e-4, "visual.finetune_convs": 2,
    # GARAT: 50,000 steps in rollouts of 2000, sampled actions, PPO and D
    "feeding.garat_rollout": 2000, "schedule.finetune.dynamics": 25, "dynamics.deterministic": False,
    "dynamics.residual_scale": 1.0, "dynamics.lr": 3e-5, "dynamics.batch_size": 128, "dynamics.gamma": 0.99,
    "dynamics.entropy_weight": 1e-4, "dynamics.clip": 0.2, "dynamics.lr_discriminator": 1e-2,
    "dynamics.discriminator_batches": 15, "dynamics.gradient_penalty_weight": 10.0, "episodes": 10,
}  # fmt: skip
VALUES = {"paper": PAPER, "official": OFFICIAL}
STEPS = {
    "paper": {"half_cheetah": (200_000, 200_000), "walker2d": (200_000, 200_000)},
    "official": {
        "inverted_pendulum": (100_000, 10_000), "sawyer_push": (100_000, 10_000), "fetch_reach": (500_000, 10_000),
        "half_cheetah": (0, 100_000), "walker2d": (0, 100_000),
    },
}  # fmt: skip
"""Steps of the policy before the first grounding step and in each; in the paper else 10,000 (Appendix)."""


def preset(name):
    return ROOT / "configs" / "presets" / f"{name}.yaml"


def parsed(*configs):
    """The run's config, as it is trained, and what the command line parsed."""
    cli = GroundingCLI([a for c in configs for a in ("--config", str(c))])
    return cli.run().config, cli.config


def told(config, key):
    """A value of a parsed config by its dotted key; tuples as lists."""
    value = config[key]
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("config", CONFIGS, ids=lambda p: p.stem)
def test_a_preset_over_any_config_gives_what_its_name_says(config, name):
    run, cli = parsed(config, preset(name))
    assert {key: told(cli, key) for key in VALUES[name]} == VALUES[name]
    lengths = run.schedule.pretrain.policy, run.schedule.finetune.policy
    assert lengths == STEPS[name].get(run.task, (10_000, 10_000)) and run.schedule.source_policy > 0
    backwards = name == "paper" and run.task in ("half_cheetah", "walker2d")  # Fig. 4
    assert run.schedule.exploration == ("backwards" if backwards else "random")
    assert run.schedule.grounding_steps == (1 if name == "paper" and run.target == "easy" else 5)
    alone = yaml.safe_load(config.read_text())
    assert (run.task, run.target) == (alone["task"], alone["target"])


METHODS = sorted(p.stem for p in preset("paper").parent.glob("*.yaml") if p.stem not in VALUES)
OFTEN = ("dr_wide", "adaptive_rl", "data_backwards", "cc_state", "paper_small")
"""Presets that are laid over the cheetah's config too, in the quick tests; the rest is slow."""


def leaves(entries, prefix=""):
    """Dotted keys to values of nested entries."""
    found = {}
    for key, value in entries.items():
        inside = isinstance(value, dict) and value
        found |= leaves(value, f"{prefix}{key}.") if inside else {f"{prefix}{key}": value}
    return found


def often(config, name):
    return config.stem == "pendulum_quick" or (config.stem == "cheetah_quick" and name in OFTEN)


@pytest.mark.parametrize(
    ("config", "name"),
    [
        pytest.param(c, n, id=f"{c.stem}-{n}", marks=[] if often(c, n) else pytest.mark.slow)
        for c in CONFIGS for n in METHODS
    ],
)  # fmt: skip
def test_a_methods_preset_gives_what_it_says_and_leaves_the_rest(config, name):
    def flat(*configs):
        cli = GroundingCLI([a for c in configs for a in ("--config", str(c))])
        return cli, {k: list(v) if isinstance(v, tuple) else v for k, v in leaves(cli.config.as_dict()).items()}

    said = leaves(yaml.safe_load(preset(name).read_text()))
    cli, over = flat(config, preset(name))
    alone = flat(config)[1]
    filled = {k for k, v in said.items() if v is None and k.startswith("schedule.")} | {"schedule.lengths"}
    assert {k: over[k] for k in said if k not in filled} == {k: v for k, v in said.items() if k not in filled}
    changed = {k for k in over if over[k] != alone.get(k)} - {"config"}
    assert changed <= {*said, *filled}
    if "backwards" in name and config.stem.split("_")[0] not in ("cheetah", "walker"):
        with pytest.raises(ValueError, match="has no direction"):
            cli.run()
    else:
        assert cli.run().method is not None


def test_the_small_preset_of_the_paper_is_its_method_with_other_sizes():
    paper, small = (leaves(yaml.safe_load(preset(n).read_text())) for n in ("paper", "paper_small"))
    view = {"view.share", "view.up", "view.right"}  # the config's own window, as images are smaller
    assert set(small) == set(paper) - view
    sizes = {
        "image_size", "episodes", "vision.crop", "vision.strides", "visual.width", "visual.blocks",
        "visual.discriminator_width", "dynamics.hidden", "policy.hidden", "schedule.images", "schedule.source_policy",
        "feeding.visual_batch", "feeding.num_envs", "feeding.updates_per_step", "feeding.buffer_size",
        "feeding.garat_rollout",
    }  # fmt: skip
    stages = ("state_predictor", "visual", "policy")
    sizes |= {f"schedule.{part}.{name}" for part in ("pretrain", "finetune") for name in stages}
    assert {k for k in small if small[k] != paper[k]} <= sizes


@pytest.mark.parametrize("name", VALUES)
def test_a_preset_leaves_no_length_and_no_option_of_teacher_and_filter_to_what_lies_beneath(name):
    settings = yaml.safe_load(preset(name).read_text())
    for part in ("pretrain", "finetune"):
        assert set(settings["schedule"][part]) == set(StageLengths.__dataclass_fields__)
    assert set(settings["teacher"]) == set(TeacherSettings.__dataclass_fields__) - {"fading", "updates_per_step"}
    assert set(settings["schedule"]) == set(Schedule.__dataclass_fields__)


@pytest.mark.parametrize("name", VALUES)
def test_a_preset_takes_filter_and_rehearsals_out_of_a_config(name, tmp_path):
    mine = tmp_path / "mine.yaml"
    lengths = {"policy": 0, "rehearsed": 10, "filter": 10, "state_predictor": 1, "visual": 1}
    mine.write_text(yaml.safe_dump({
        "schedule": {"source_policy": 0, "pretrain": lengths, "finetune": lengths},
        "teacher": {"steps": 100, "rehearse": 100, "noise": 0.1},
        "policy": {"encoder": "supervised", "memory": 8},
        "labels": {"members": 16},
    }))  # fmt: skip
    assert parsed(mine)[0].modules["policy"]["memory"] == 8
    config, _ = parsed(mine, preset(name))
    assert config.modules["policy"]["memory"] == config.labels.members == 0
    assert (config.teacher.steps, config.teacher.rehearse, config.teacher.noise) == (0, 0, 0)
    assert config.schedule.pretrain.filter == config.schedule.finetune.rehearsed == 0


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize(
    ("key", "own"),
    [("pretrain.policy", 100), ("finetune.policy", 0), ("source_policy", 7), ("grounding_steps", 2)],
)
def test_lengths_that_are_given_after_a_preset_win(key, own, name, tmp_path):
    """On the command line or in a later config; all others are the preset's, and numbers are what the run keeps."""
    expected = parsed(QUICK, preset(name))[1].schedule.as_dict()
    part, _, last = key.rpartition(".")
    (expected[part] if part else expected)[last] = own
    mine = tmp_path / "mine.yaml"
    mine.write_text(yaml.safe_dump({"schedule": {part: {last: own}} if part else {last: own}}))
    over = ["--config", str(QUICK), "--config", str(preset(name))]
    for given in ([f"--schedule.{key}={own}"], ["--config", str(mine)]):
        cli = GroundingCLI([*over, *given])
        assert cli.config.schedule.as_dict() == expected and cli.run().config.schedule.lengths == "given"


@pytest.mark.parametrize(("over", "given", "says"), [
    (True, ["schedule.lengths=given"], "schedule.grounding_steps is null: give a number"),
    (False, ["schedule.lengths=paper"], "schedule.lengths is paper, but there are numbers for all that it says"),
    (False, ["schedule.pretrain.policy=null"], "schedule.pretrain.policy is null: give a number"),
    (True, ["task=cart"], "has no steps for the task 'cart'; give schedule.grounding_steps"),
])  # fmt: skip
def test_lengths_that_nothing_or_two_things_say_are_refused(over, given, says, tmp_path, capsys):
    configs = [QUICK, preset("paper")] if over else [QUICK]
    args = [a for c in configs for a in ("--config", str(c))]
    assert main(["fit", *args, *(f"--{g}" for g in given), f"--run_dir={tmp_path / 'run'}"]) == 1
    assert says in capsys.readouterr().err and not (tmp_path / "run").exists()


@pytest.mark.parametrize("config", [c for c in CONFIGS if c.stem.endswith("_quick")], ids=lambda p: p.stem)
def test_a_quick_config_under_the_papers_preset_is_the_hard_one_under_it(config):
    """Nothing of the quick one is left, keys that the table above does not name included."""

    def settings(run: RunConfig):
        modules = {name: {k: v for k, v in m.items() if k != "bf16"} for name, m in run.modules.items()}
        for key in ("estimator_updates", "lr_estimator"):  # of another encoder
            del modules["policy"][key]
        return run.__dict__ | {"modules": modules, "schedule": run.schedule.__dict__ | {"lengths": ""}}

    hard = config.with_stem(config.stem.replace("quick", "hard"))
    assert settings(parsed(config, preset("paper"))[0]) == settings(parsed(hard, preset("paper"))[0])


@pytest.mark.parametrize("config", [c for c in CONFIGS if not c.stem.endswith("_quick")], ids=lambda p: p.stem)
def test_a_named_config_takes_few_target_steps_and_easy_and_hard_differ_in_the_target_alone(config):
    schedule = parsed(config)[0].schedule
    most = 2000 if config.stem.startswith("pendulum") else 12_500
    assert schedule.images + schedule.grounding_steps * schedule.interactions <= most
    easy, hard = (yaml.safe_load(config.with_stem(f"{config.stem[:-5]}_{t}").read_text()) for t in ("easy", "hard"))
    assert easy | {"target": "hard"} == hard


@pytest.mark.parametrize("name", ["paper", pytest.param("official", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "task", ["pendulum", *(pytest.param(t, marks=pytest.mark.slow) for t in ("cheetah", "walker", "fetch", "sawyer"))]
)
def test_algorithm_1_starts_with_a_preset(task, name, tmp_path):
    quick = QUICK.with_stem(f"{task}_quick")
    small = TINY | {
        "schedule.lengths": "given", "schedule.grounding_steps": 1, "run_dir": tmp_path / "run",
        "schedule.pretrain.estimator": 0, "schedule.finetune.estimator": 0, "feeding.trial_episodes": 0,
        "feeding.trial_repeats": 0,
        "feeding.buffer_size": 100, "schedule.exploration": "random",
    }  # fmt: skip
    overrides = [f"--{k}={v}" for k, v in small.items()]
    assert main(["fit", "--config", str(quick), "--config", str(preset(name)), *overrides]) == 0
    assert (tmp_path / "run/step_01/dynamics/final.ckpt").exists()


def test_an_oracle_that_would_not_train_is_refused_and_its_preset_says_how_long_it_does(tmp_path):
    teachers = QUICK.with_stem("cheetah_quick")
    with pytest.raises(ValueError, match="the oracle trains by SAC for as long as the run's policies do"):
        GroundingCLI(["--config", str(teachers), "--oracle", "true", "--run_dir", str(tmp_path)]).run()
    run, _ = parsed(teachers, preset("oracle"))
    assert run.method == "oracle" and run.schedule.source_policy == 10_000 and not run.teacher.steps
    assert parsed(QUICK)[0].schedule.source_policy, "the pendulum's policies do train by SAC"
