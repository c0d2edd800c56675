"""`idapt fit` refuses what cannot be right before it does anything."""

import contextlib
import io

import pytest
import yaml
from conftest import QUICK
from fuzzing import NO_YAML, assert_refused, damaged, leaves

from cli.fit import GroundingCLI

with contextlib.redirect_stderr(io.StringIO()):
    CLI = GroundingCLI([])
    DEFAULTS = leaves(yaml.safe_load(CLI.parser.dump(CLI.config, skip_none=False)))

NUMBERS = {
    key: value
    for key, value in DEFAULTS.items()
    if isinstance(value, int | float) and not isinstance(value, bool) and not key.startswith("trainer.")
}
"""Every setting that is a number, and its default."""

MAY_BE_NEGATIVE = {"dynamics.initial_log_std"}
WRONG_NUMBERS = ("-7", ".nan")
"""For every number."""
IN_TURN = ("-.inf", "1e400", "many", "{a: 1}", "[[1]]")
"""Two of them for each: what a number's type refuses is the same for all."""
WRONG = [
    (key, value)
    for i, key in enumerate(NUMBERS)
    for value in (*WRONG_NUMBERS, IN_TURN[i % len(IN_TURN)], IN_TURN[(i + 2) % len(IN_TURN)])
]


def fit(*options):
    return ["fit", "--config", QUICK, "--run_dir", "run", *options]


def test_there_are_many_of_them():
    assert len(WRONG) + len(CANNOT_BE) + len(NO_YAML) >= 500


@pytest.mark.parametrize(("key", "value"), WRONG)
def test_numbers_that_cannot_be_right(key, value, tmp_path):
    if not (key in MAY_BE_NEGATIVE and value == "-7"):
        said = assert_refused(["fit", "--run_dir", "run", f"--{key}={value}"], tmp_path)  # the rest has its default
        assert key in said or key.split(".")[-1] in said, said


CANNOT_BE = [
    "feeding.garat_exploring=7", "feeding.garat_envs=0", "feeding.num_envs=0", "feeding.num_envs=100000",
    "feeding.garat_rollout=3", "feeding.buffer_size=0", "feeding.updates_per_step=0", "feeding.garat_start=magic",
    "feeding.policy_batch=1000000000000", "schedule.interactions=0", "schedule.images=0", "schedule.source_images=0",
    "schedule.grounding_steps=100", "schedule.exploration=rehearse", "schedule.exploration=walk",
    "schedule.source_policy=3", "schedule.pretrain.policy=1", "schedule.finetune.policy=2", "schedule.pretrain=3",
    "schedule.finetune=null", "schedule.accumulate=maybe", "schedule.rollback=2",
    "schedule.lengths=paper", "schedule.lengths=mine", "schedule.grounding_steps=null", "schedule.finetune.policy=null",
    "image_size=33", "image_size=20", "image_size=0", "image_size=100000", "frame_stack=0", "frame_stack=1000",
    "vision.crop=65", "vision.crop=0", "vision.crop=4", "vision.strides=[1]", "vision.strides=[0,1,1,1]",
    "vision.strides=[8,8,8,8]", "vision.pool=maximum", "vision.rates=guessed", "view.share=0", "view.share=2",
    "view.up=5", "view=3", "visual.betas=[1,1]", "visual.betas=[0.5]", "visual.betas=[-1,0.9]", "visual.ema_decay=1",
    "visual.translate=video", "visual.gan_loss=none", "visual.discriminator_layers=9", "visual.discriminator_layers=8",
    "visual.finetune_convs=5", "visual.width=100000", "visual.blocks=0", "dynamics.hidden=[0]", "dynamics.hidden=[-3]",
    "dynamics.hidden=[many]", "dynamics.hidden=3", "dynamics.hidden=[1000000000]", "dynamics.smoothing=2",
    "dynamics.epochs=0", "dynamics.clip=0", "dynamics.gamma=1.5", "policy.hidden=[]]", "policy.gamma=1.01",
    "policy.tau=0", "policy.tau=2", "policy.temperature=0", "policy.encoder=magic", "policy.encoder=learned",
    "policy.target_entropy=.nan", "policy.lr=-1", "policy.actor_every=0", "policy.action_low=[1]", "policy.state_dim=3",
    "teacher.steps=100", "teacher.dagger=100", "teacher.fading=0", "teacher.fading=2", "teacher=[]",
    "effects.candidates=[nothing]", "effects.candidates=body_mass", "effects.max_effects=0", "effects.discover=perhaps",
    "task=pendulum", "task=", "task=null", "task=[1]", "target=harder", "target=../..", "target=null", "episodes=0",
    "render_processes=-1", "render_processes=1000000", "seed=99999999999", "seed=null", "seed=1.5", "oracle=7",
    "seed_everything=3", "trainer.devices=2", "trainer.devices=0", "trainer.devices=-1", "trainer.devices=[0,1]",
    "trainer.devices=many", "trainer.num_nodes=2", "trainer.accelerator=moon", "trainer.precision=7",
    "trainer.strategy=magic", "trainer.gradient_clip_val=x", "trainer.max_epochs=x", "trainer.logger=3",
    "trainer=3", "nothing=3", "visual=3", "policy=null", "schedule.pretrain.visual.x=3", "model.width=3",
]  # fmt: skip


@pytest.mark.parametrize("option", CANNOT_BE)
def test_settings_that_cannot_be_right(option, tmp_path):
    assert_refused(fit(f"--{option}"), tmp_path)


@pytest.mark.parametrize("args", [
    ["--config"], ["--config", ""], ["--config", "."], ["--config", "none.yaml"], ["--config", "/dev/null/x"], ["--"],
    ["-x"], ["--seed"], ["words"], ["--seed", "3", "words"], ["--schedule"], ["--print_config=moon", "--seed=-1"],
    ["--config={}", "--seed=-1"], ["--config=[]"], ["--config=3"], ["--seed=" + "9" * 5000], ["--\udcff=1"],
])  # fmt: skip
def test_words_that_are_no_options(args, tmp_path):
    assert_refused(["fit", *args], tmp_path)


@pytest.mark.parametrize("kind", NO_YAML)
def test_files_that_are_no_config(kind, tmp_path):
    for name in ("config.yaml", "mine.yaml"):
        (tmp_path / name).write_bytes(NO_YAML[kind])
        assert_refused(["fit", "--config", name, "--run_dir", "run"], tmp_path)


@pytest.mark.parametrize("seed", range(60))
def test_damaged_configs(seed, tmp_path):
    """Some are harmless, in a comment; 33 pixels are what no config can have, and are looked at last."""
    name = "config.yaml" if seed % 2 else "mine.yaml"  # the first is also looked at for keys that are gone
    (tmp_path / name).write_bytes(damaged(QUICK.read_bytes(), seed))
    assert_refused(["fit", "--config", name, "--run_dir", "run", "--image_size=33"], tmp_path)
