# ruff: noqa: E501 (inputs are read best one a line)
"""The other commands refuse what cannot be right, and write nothing."""

import numpy as np
import pytest
from fuzzing import NO_YAML, assert_refused, damaged

COLLECT = ["collect", "--task", "inverted_pendulum", "--domain", "source", "--out", "o.h5"]


@pytest.mark.parametrize("args", [
    ["nothing"], ["--nothing"], ["fit fit"], [""], ["\x00"], ["export"], ["doctor", "now"], ["doctor", "--xml"],
    ["collect"], COLLECT[:-2], [*COLLECT, "--steps", "0"], [*COLLECT, "--steps", "-5"], [*COLLECT, "--steps", "1e3"],
    [*COLLECT, "--steps", "9" * 30], [*COLLECT, "--image-size", "0"], [*COLLECT, "--image-size", "-1"],
    [*COLLECT, "--image-size", "1000000"], [*COLLECT, "--seed", "-1"], [*COLLECT, "--seed", "9" * 30],
    [*COLLECT, "--policy", "magic"], [*COLLECT, "--task", "magic"], [*COLLECT, "--domain", "magic"],
    [*COLLECT, "--out", "."], [*COLLECT, "--steps", "1", "--policy", "random+expert"],
    ["gallery"], ["gallery", "--out", "file"], ["gallery", "--out", "g", "--task", "magic"],
    ["gallery", "--out", "g", "--image-size", "0"], ["gallery", "--out", "g", "--image-size", "many"],
    ["gallery", "--out", "g", "--run", "none"], ["gallery", "--out", "g", "--run", "."], ["gallery", "--out", "g", "--run", "file"],
    ["evaluate"], ["evaluate", "--run", "none"], ["evaluate", "--run", "."], ["evaluate", "--run", "file"],
    ["evaluate", "--run", ".", "--episodes", "0"], ["evaluate", "--run", ".", "--episodes", "-3"],
    ["evaluate", "--run", ".", "--seed", "-1"], ["evaluate", "--run", ".", "--episodes", "nan"],
    ["report"], ["report", "--run", "none"], ["report", "--run", "."], ["report", "--run", "file"],
    ["report", "--run", ".", "--out", "file"], ["report", "--run", "\x00"],
])  # fmt: skip
def test_arguments_that_cannot_be_right(args, tmp_path):
    (tmp_path / "file").write_text("something")
    assert_refused(args, tmp_path)


WRONG_VISUAL = [
    "data.root=none", "data.root=file", "data.source=none", "data.source=[]", "data.size=[3,3]", "data.size=[33,32]",
    "data.size=3", "data.frame_stack=0", "data.frame_stack=2", "data.batch_size=0", "data.batch_size=-1", "data.workers=-1",
    "data.fit=magic", "data.on_bad=ask", "data.labels=none.npy", "data.labels=file", "data.augment=3", "model.width=0",
    "model.width=-3", "model.blocks=-1", "model.betas=[2,2]", "model.lr_generator=-1", "model.lr_generator=.nan",
    "model.translate=video", "model.ema_decay=2", "model.reset_weight=.inf", "model.nothing=3", "model=3",
    "labelled.batches=-1", "labelled.lr=0", "labelled.batch_size=0", "vision.strides=[0,1,1,1]", "vision.crop=-1",
    "trainer.devices=many", "trainer.accelerator=moon", "trainer.precision=7", "trainer.max_epochs=x", "trainer.strategy=magic",
    "seed_everything=x", "ckpt_path=none.ckpt", "ckpt_path=file", "nothing=3", "config=none.yaml", "config=file", "config=.",
]  # fmt: skip


@pytest.fixture
def photos(tmp_path):
    """A few images of each domain."""
    import imageio.v3 as iio

    for name in ("trainA", "trainB"):
        (tmp_path / "photos" / name).mkdir(parents=True)
        for i in range(2):
            iio.imwrite(tmp_path / "photos" / name / f"{i}.png", np.full((24, 24, 3), 100, np.uint8))
    (tmp_path / "file").write_text("something")
    return tmp_path


def visual(*options, command="fit"):
    small = ("model.width=4", "model.blocks=1", "trainer.max_epochs=1", "trainer.accelerator=cpu", "data.root=photos")
    return ["visual", command, *(f"--{option}" for option in (*small, "run_dir=run", *options))]


@pytest.mark.parametrize("option", WRONG_VISUAL)
def test_settings_of_visual_fit_that_cannot_be_right(option, photos):
    said = assert_refused(visual(option), photos, may_write="run")
    assert option.split("=")[0].split(".")[-1] in said or option.split("=")[1] in said, said


@pytest.mark.parametrize("kind", NO_YAML)
def test_files_that_are_no_image(kind, photos):
    (photos / "photos/trainA/0.png").write_bytes(NO_YAML[kind])
    assert_refused(visual(), photos, may_write="run")


@pytest.mark.parametrize("kind", NO_YAML)
def test_files_that_are_no_checkpoint(kind, photos):
    (photos / "bad.ckpt").write_bytes(NO_YAML[kind])
    assert_refused(["visual", "export", "--ckpt_path", "bad.ckpt", "--out", "g.pt2"], photos)


@pytest.mark.parametrize("seed", range(20))
def test_damaged_images(seed, photos):
    """Some can still be read; 25 pixels are what no model can have."""
    path = photos / "photos/trainB/1.png"
    path.write_bytes(damaged(path.read_bytes(), seed))
    assert_refused(visual("data.size=[25,25]"), photos, may_write="run")


@pytest.mark.parametrize("args", [
    ["visual"], ["visual", "train"], ["visual", "export"], ["visual", "export", "--out", "g.pt2"],
    ["visual", "export", "--out", "file", "--ckpt_path", "file"], ["visual", "export", "--out", "g.exe", "--ckpt_path", "file"],
    ["visual", "predict"], ["visual", "predict", "--run_dir", "none"], ["visual", "predict", "--ckpt_path", "file"],
    ["visual", "validate", "--ckpt_path", "."], ["visual", "test", "--ckpt_path", "none"],
])  # fmt: skip
def test_wrong_arguments_of_visual(args, photos):
    assert_refused(args, photos)
