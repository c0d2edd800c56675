"""`idapt visual`: trained on folders and trajectories, resumed, used, and plain about mistakes."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch
import yaml
from conftest import ROOT

import cli.visual
from cli.main import main
from cli.visual_writer import check_distinct
from datamodules import read_trajectories, write_trajectories
from idapt_pl.modules import VisualTransformation

SMALL = {
    "model.width": 4, "model.blocks": 1, "model.discriminator_width": 4, "model.pool_size": 3,
    "trainer.accelerator": "cpu", "trainer.max_epochs": 2, "trainer.log_every_n_steps": 1,
}  # fmt: skip


def squares(folder, n, color, background, size=(24, 32)):
    """Images with a square somewhere, as PNG files."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(n)
    for i in range(n):
        image = np.full((*size, 3), background, np.uint8)
        top, left = rng.integers(0, size[0] - 6), rng.integers(0, size[1] - 6)
        image[top : top + 6, left : left + 6] = color
        iio.imwrite(folder / f"{i}.png", image)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    root = tmp_path_factory.mktemp("photos")
    squares(root / "trainA", 6, (255, 0, 0), 20)
    squares(root / "trainB", 5, (0, 0, 255), 120)
    return root


def visual(capsys, subcommand, **options):
    """Exit code and message of `idapt visual`; ``__`` stands for a dot."""
    args = [f"--{k.replace('__', '.')}={v}" for k, v in options.items()]
    try:
        code = main(["visual", subcommand, *args])
    except SystemExit as end:
        code = end.code
    return code, " ".join(capsys.readouterr().err.split())


def fit(capsys, run, **options):
    small = {k.replace(".", "__"): v for k, v in SMALL.items()}
    return visual(capsys, "fit", run_dir=run, **(small | options))


def weights(run):
    return torch.load(run / "last.ckpt", weights_only=True)["state_dict"]


@pytest.fixture(scope="module")
def trained(photos, tmp_path_factory):
    """A run folder, trained for two epochs."""
    run = tmp_path_factory.mktemp("runs") / "photos"
    args = [f"--{k}={v}" for k, v in SMALL.items()]
    assert main(["visual", "fit", f"--data.root={photos}", f"--run_dir={run}", *args]) == 0
    return run


def test_a_run_leaves_a_checkpoint_its_config_and_its_metrics(trained):
    assert {"last.ckpt", "config.yaml", "run.json", "metrics.csv"} <= {p.name for p in trained.iterdir()}
    module = VisualTransformation.from_checkpoint(trained / "last.ckpt")
    assert module.hparams.image_size == [24, 32] and module.hparams.width == 4


@pytest.mark.parametrize(
    ("can", "given", "expected"),
    [(True, {}, "bf16-mixed"), (False, {}, "32-true"), (True, {"trainer__precision": "32-true"}, "32-true")],
)
def test_precision_is_the_devices_unless_it_is_given(trained, photos, capsys, monkeypatch, can, given, expected):
    monkeypatch.setattr(cli.visual, "computes_bfloat16", lambda device: can)
    seen = []
    monkeypatch.setattr(cli.visual.VisualCLI, "validate", lambda self, **_: seen.append(self.trainer.precision), False)
    code, _ = visual(capsys, "validate", run_dir=trained, data__root=photos, trainer__accelerator="cpu", **given)
    assert code == 0 and seen == [expected]


def test_predict_writes_an_image_for_each_at_the_size_it_came_with(trained, tmp_path, capsys):
    squares(tmp_path / "new" / "deep", 3, (255, 0, 0), 20, size=(23, 35))
    out = tmp_path / "out"
    code, _ = visual(
        capsys, "predict", run_dir=trained, data__predict=tmp_path / "new", predictions__out=out,
        trainer__accelerator="cpu", trainer__precision="32-true", data__batch_size=2,
    )  # fmt: skip
    assert code == 0
    written = sorted(p.relative_to(out).as_posix() for p in out.rglob("*.*"))
    assert written == ["deep/0.png", "deep/1.png", "deep/2.png"]
    assert iio.imread(out / "deep/0.png").shape == (23, 35, 3)


def test_predicted_images_are_what_g_makes_of_them_and_targets_go_back(trained, photos, tmp_path, capsys):
    module = VisualTransformation.from_checkpoint(trained / "last.ckpt")
    for domain, letter, net in (("source", "A", module.G), ("target", "B", module.G_back)):
        code, _ = visual(
            capsys, "predict", run_dir=trained, data__root=photos, data__predict_domain=domain,
            predictions__out=tmp_path / domain, trainer__accelerator="cpu", trainer__precision="32-true",
        )  # fmt: skip
        assert code == 0
        image = torch.from_numpy(iio.imread(photos / f"train{letter}" / "0.png"))
        with torch.no_grad():
            expected = (net(image.movedim(-1, 0)[None] / 127.5 - 1)[0].movedim(0, -1) + 1) * 127.5
        found = iio.imread(tmp_path / domain / "0.png").astype(float)
        assert np.abs(found - expected.numpy()).max() <= 0.51


def test_a_run_that_was_interrupted_goes_on_as_if_it_had_not_been(trained, photos, tmp_path, capsys, monkeypatch):
    step, seen = VisualTransformation.training_step, []

    def stops_in_the_second_epoch(self, batch, index):
        seen.append(index)
        if len(seen) == 9:
            signal.raise_signal(signal.SIGTERM)
        return step(self, batch, index)

    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(VisualTransformation, "training_step", stops_in_the_second_epoch)
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        code, err = fit(capsys, run, data__root=photos)
        for number, handler in handlers.items():  # a program that leaves ignores both
            signal.signal(number, handler)
    assert code == 143 and f"finished epochs are kept in {run}, go on with: idapt visual fit --config" in err
    assert fit(capsys, run, data__root=photos)[0] == 0
    assert (run / "metrics_0.csv").exists(), "what was measured before the interruption is kept"
    uninterrupted, resumed = weights(trained), weights(run)
    assert [k for k in uninterrupted if not torch.equal(uninterrupted[k], resumed[k])] == []


def test_a_folder_with_another_config_is_not_trained_on(trained, photos, capsys):
    before = weights(trained)
    code, err = fit(capsys, trained, data__root=photos, model__blocks=2)
    assert code == 1 and "another config (model.blocks differ)" in err
    assert all(torch.equal(v, before[k]) for k, v in weights(trained).items())


def test_trajectories_with_states_are_translated_into_trajectories(tmp_path, numbered, capsys):
    for name in ("s", "t"):
        write_trajectories(tmp_path / f"{name}.h5", numbered([3, 4], size=24))
    options = {"data__source": tmp_path / "s.h5", "data__frame_stack": 2}
    tests = {"data__test_source": tmp_path / "s.h5", "data__test_target": tmp_path / "t.h5", "data__paired": "true"}
    code, err = fit(
        capsys, tmp_path / "run", **options, **tests, data__target=tmp_path / "t.h5", model__consistency_weight=1.0,
        quality__target_states=tmp_path / "t.h5", quality__probe_batches=2, quality__state_batches=2,
        model__ema_decay=0.9, labelled__batches=5, trainer__max_epochs=1, trainer__limit_train_batches=2,
        vision__pool="keypoints", vision__strides="[2,1,1,1]",
    )  # fmt: skip
    assert code == 0, err
    logged = (tmp_path / "run" / "metrics.csv").read_text()
    assert "visual/state" in logged and "visual/consistency" in logged
    figures = json.loads((tmp_path / "run" / "quality.json").read_text())
    assert figures["state_error"] > 0 and figures["state_error_probe"] > 0 and figures["state_error_probe_floor"] > 0
    assert (tmp_path / "run" / "quality.gif").exists()
    out = tmp_path / "translated.h5"
    used = {**options, "run_dir": tmp_path / "run", "trainer__accelerator": "cpu"}
    code, err = visual(capsys, "predict", **used, predictions__out=tmp_path / "folder")
    assert code == 1 and "becomes a trajectory file (.h5)" in err
    assert visual(capsys, "predict", **used, predictions__out=out)[0] == 0
    old, new = read_trajectories(tmp_path / "s.h5"), read_trajectories(out)
    for a, b in zip(old, new, strict=True):
        assert np.array_equal(a.actions, b.actions) and np.array_equal(a.observations["state"], b.observations["state"])
        assert a.observations["pixels"].shape == b.observations["pixels"].shape
        assert not np.array_equal(a.observations["pixels"], b.observations["pixels"])


def test_torchvision_datasets_are_named_on_the_command_line_and_loaded_by_workers(tmp_path, capsys):
    fake = "torchvision.datasets.FakeData"
    data = {"data__source__class_path": fake, "data__source__init_args__size": 3, "data__target__class_path": fake}
    data |= {"data__target__init_args__size": 2, "data__workers": 1, "data__cache": "false"}
    data |= {f"data__{d}__init_args__image_size": "[3,24,32]" for d in ("source", "target")}
    assert fit(capsys, tmp_path / "run", **data, trainer__max_epochs=1)[0] == 0
    assert VisualTransformation.from_checkpoint(tmp_path / "run" / "last.ckpt").hparams.image_size == [24, 32]


@pytest.mark.parametrize(
    ("options", "expected", "says"),
    [
        ({"data__root": "nowhere"}, 1, "nowhere: no such folder"),
        ({"data__rot": "x"}, 2, "data.rot"),
        ({"model__width": "wide"}, 2, "model.width"),
        ({"data__root": "{photos}", "model__consistency_weight": 1}, 1, "frame_stack is 1"),
        ({"data__root": "{photos}", "data__size": "[30, 30]"}, 1, "multiples of 4, got [30, 30]"),
    ],
)
def test_mistakes_are_told_plainly_and_leave_nothing(photos, tmp_path, capsys, options, expected, says):
    options = {k: str(v).format(photos=photos) for k, v in options.items()}
    code, err = fit(capsys, tmp_path / "run", **options)
    assert code == expected and says in err and "Traceback" not in err, err
    assert not (tmp_path / "run").exists()


def test_using_a_model_that_is_none_is_told_plainly(tmp_path, capsys):
    code, err = visual(capsys, "predict", run_dir=tmp_path / "run")
    assert code == 1 and "no such checkpoint" in err
    torch.save({"state_dict": {}}, tmp_path / "other.ckpt")
    code, err = visual(capsys, "predict", ckpt_path=tmp_path / "other.ckpt")
    assert code == 1 and "other.ckpt: cannot be used (it does not hold 'hyper_parameters')" in err
    assert "Expected a checkpoint of a visual transformation" in err


def test_translations_are_measured_before_and_after_and_alike_in_fit_and_test(tmp_path, capsys, caplog):
    caplog.set_level("INFO", "cli.visual")
    for letter, color, background in (("A", (255, 0, 0), 20), ("B", (0, 0, 255), 120)):
        for part, n in (("train", 12), ("test", 13)):
            squares(tmp_path / "pairs" / f"{part}{letter}", n, color, background)
    options = {"data__root": tmp_path / "pairs", "data__paired": "true", "quality__probe_batches": 10}
    assert fit(capsys, tmp_path / "run", **options, trainer__max_epochs=1)[0] == 0
    assert "not measured" not in caplog.text
    figures = tmp_path / "run" / "quality.json"
    after_fit = json.loads(figures.read_text())
    assert set(after_fit) == {"kid", "kid_before", "kid_floor", "psnr", "psnr_before", "ssim", "ssim_before"}
    red, blue = (iio.imread(tmp_path / "pairs" / f"test{x}" / "0.png").astype(float) for x in "AB")
    assert after_fit["psnr_before"] == pytest.approx(10 * np.log10(255**2 / np.square(red - blue).mean()), abs=1e-3)
    assert after_fit["kid_floor"] < after_fit["kid_before"]
    figures.unlink()
    used = {"run_dir": tmp_path / "run", "trainer__accelerator": "cpu"}
    assert visual(capsys, "test", **options, **used)[0] == 0
    assert json.loads(figures.read_text()) == pytest.approx(after_fit, abs=1e-3)
    assert iio.imread(tmp_path / "run" / "quality.png").shape[2] == 3
    code, err = visual(capsys, "test", data__source=tmp_path / "pairs" / "trainA", **used)
    assert code == 1 and "data.test_source" in err


def test_what_to_do_next_is_told_as_it_is_to_be_typed(photos, tmp_path, capsys, caplog):
    caplog.set_level("INFO", "cli.visual")
    assert fit(capsys, tmp_path / "my run", data__root=photos, trainer__max_epochs=1)[0] == 0
    assert f"tensorboard --logdir '{tmp_path}/my run'" in caplog.text
    assert "how good G is was not measured: --data.test_source and --data.test_target" in caplog.text


@pytest.mark.parametrize("preset", sorted((ROOT / "configs" / "visual").glob("*.yaml")), ids=lambda p: p.stem)
def test_presets_train(preset, photos, tmp_path, capsys):
    code, err = visual(
        capsys, "fit", config=preset, data__root=photos, data__batch_size=1, run_dir=tmp_path / "run",
        trainer__max_epochs=1, trainer__limit_train_batches=1, trainer__accelerator="cpu",
    )  # fmt: skip
    assert code == 0, err
    settings = dict(VisualTransformation.from_checkpoint(tmp_path / "run" / "last.ckpt").hparams)
    for name, value in yaml.safe_load(preset.read_text())["model"].items():
        assert settings[name] == (tuple(value) if isinstance(value, list) else value), name


@pytest.mark.parametrize(("suffix", "back"), [(".pt2", False), (".onnx", True)])
def test_exported_g_is_one_file_that_does_what_the_module_does(trained, tmp_path, capsys, suffix, back):
    if suffix == ".onnx":
        pytest.importorskip("onnxscript")
        pytest.importorskip("onnxruntime")
    path = tmp_path / f"G{suffix}"
    assert main(["visual", "export", f"--run_dir={trained}", f"--out={path}", *["--back"] * back]) == 0
    differs = "0" if suffix == ".pt2" else "[01]"  # another engine may round a half the other way
    assert re.search(f"differs by at most {differs} of 255", capsys.readouterr().out)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    module = VisualTransformation.from_checkpoint(trained / "last.ckpt")
    pixels = torch.randint(0, 256, (1, 1, 28, 44, 3), dtype=torch.uint8)
    with torch.no_grad():
        expected = module.translate_stacks(pixels, back).numpy().astype(int)
    if suffix == ".pt2":
        found = torch.export.load(path).module()(pixels).numpy()
    else:
        found = importlib.import_module("onnxruntime").InferenceSession(path).run(None, {"pixels": pixels.numpy()})[0]
    assert np.abs(found - expected).max() <= (2 if module.hparams.bf16 else 1)


def test_exporting_to_another_kind_of_file_is_told_plainly(trained, tmp_path, capsys):
    code, err = visual(capsys, "export", run_dir=trained, out=tmp_path / "G.tflite")
    assert code == 1 and ".pt2, .onnx" in err and not (tmp_path / "G.tflite").exists()


@pytest.mark.slow
def test_two_processes_train_one_model_together(photos, tmp_path):
    run = tmp_path / "run"
    args = [f"--{k}={v}" for k, v in SMALL.items()]
    command = [sys.executable, "-m", "cli", "visual", "fit", f"--data.root={photos}", f"--run_dir={run}", *args]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*command, "--trainer.devices=2"], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    checkpoint = torch.load(run / "last.ckpt", weights_only=True)
    steps = checkpoint["loops"]["fit_loop"]["epoch_loop.batch_progress"]["total"]["completed"]
    assert steps == 2 * 3, "six images, three for each of two processes, twice"


@pytest.mark.parametrize("key", ["model.lr_generator", "model.lr_discriminator"])
def test_a_visual_transformation_on_its_own_that_breaks_is_not_kept(key, tmp_path, capsys):
    squares(tmp_path / "photos/trainA", 6, (255, 0, 0), 20)
    squares(tmp_path / "photos/trainB", 5, (0, 0, 255), 120)
    run = tmp_path / "run"
    options = SMALL | {"data.root": tmp_path / "photos", "run_dir": run, key: 1e30}
    assert main(["visual", "fit", *(f"--{k}={v}" for k, v in options.items())]) == 1
    assert f"{key} (now 1e+30)" in capsys.readouterr().err.splitlines()[-1]
    assert not list(run.rglob("*.ckpt"))


def test_images_whose_translations_would_have_one_name_are_refused():
    check_distinct([Path("a.png"), Path("deep/a.png")], "photos")
    with pytest.raises(ValueError, match=r"photos has several images whose translations would all be a\.png"):
        check_distinct([Path(name).with_suffix(".png") for name in ("a.jpg", "b.png", "a.png")], "photos")
