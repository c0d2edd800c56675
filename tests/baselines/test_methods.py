"""Every method that is a preset runs from `idapt fit`, and leaves what the others leave: ledger, summary, page."""

import h5py
import pytest
import yaml
from conftest import QUICK, ROOT, TINY

from cli.fit import GroundingCLI
from cli.main import main
from idapt_pl.baselines.methods import METHODS
from idapt_pl.files import read_json
from idapt_pl.randomisation.settings import draw_variants
from idapt_pl.run_config import METHOD_NAMES
from idapt_pl.stages.collection import EXPERTS
from idapt_pl.tasks.half_cheetah import HalfCheetah
from idapt_pl.tasks.inverted_pendulum import InvertedPendulum
from idapt_pl.tasks.recipe import ExpertRecipe

PRESETS = ROOT / "configs/presets"
SMALL = TINY | {"schedule.grounding_steps": 1, "randomisation.variants": 3}
NO_TARGET = ("direct_transfer", "dr_narrow", "dr_paper_narrow", "dr_wide", "adaptive_rl")
"""Presets that take no step in the target before its evaluation."""

TEACHER_ALONE = {
    "teacher.steps": 40, "teacher.adapt": 20, "teacher.rehearse": 60, "teacher.harden": 0, "teacher.candidates": 1,
    "schedule.source_policy": 0, "schedule.pretrain.policy": 0, "schedule.finetune.policy": 0,
}  # fmt: skip
"""A tiny teacher that acts on estimates, in place of SAC from images."""


@pytest.fixture(autouse=True)
def quick_experts(monkeypatch):
    for task in (InvertedPendulum, HalfCheetah):
        monkeypatch.setattr(task, "expert", ExpertRecipe(steps=16, warmup_steps=16, batch=8, updates_per_step=1))


def fit(folder, preset, config=QUICK, **overrides):
    """A tiny run of a preset; what the preset says wins over what is tiny but for numbers."""
    said = yaml.safe_load((PRESETS / f"{preset}.yaml").read_text())
    kept = {k: v for k, v in SMALL.items() if not told_by(said, k) or is_number(v)}
    values = kept | {k.replace("__", "."): v for k, v in overrides.items()} | {"run_dir": folder}
    configs = ["--config", str(config), "--config", str(PRESETS / f"{preset}.yaml")]
    return main(["fit", *configs, *(f"--{k}={v}" for k, v in values.items())])


def told_by(said, key):
    """Whether a preset gives a dotted key."""
    for part in key.split("."):
        if not isinstance(said, dict) or part not in said:
            return False
        said = said[part]
    return True


def is_number(value):
    """Whether a value says how long or how much."""
    return isinstance(value, int)


def results(folder):
    return read_json(folder / "summary.json"), read_json(folder / "ledger.json")


def slow(*values):
    """Values whose test takes long and says little that the others do not."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("preset", [slow(p) if "narrow" in p else p for p in NO_TARGET])
def test_what_knows_the_source_alone_takes_no_step_in_the_target(preset, tmp_path):
    assert fit(tmp_path, preset) == 0
    summary, ledger = results(tmp_path)
    assert summary["method"] == "source" and summary["target_interactions"] == ledger["training_total"] == 0
    assert {e["purpose"] for e in ledger["entries"]} == {"evaluation of direct transfer"}
    assert not list(tmp_path.glob("step_*/target.h5")) and not list(tmp_path.glob("step_*/visual"))
    assert summary["result"] == summary["direct_transfer"] > 0 and summary["grounded"] == []
    page = (tmp_path / "report.html").read_text()
    assert f"{summary['result']:.1f}" in page and "has not ended" not in page
    variants = tmp_path / "variants.yaml"
    assert variants.exists() == (preset != "direct_transfer")
    if variants.exists():
        drawn = yaml.safe_load(variants.read_text())
        assert len(drawn) == 3 and drawn[0] != drawn[1], "what was drawn is written down"


def test_a_teacher_of_the_source_alone_trains_as_long_as_the_methods_do_together(tmp_path):
    config = ["--config", str(ROOT / "configs/cheetah_quick.yaml")]
    preset = ["--config", str(ROOT / "configs/presets/direct_transfer.yaml")]
    ours, alone = (
        GroundingCLI([*args, "--run_dir", str(tmp_path / "run")]).run().context.teacher.settings
        for args in (config, config + preset)
    )
    assert ours.adapt > 0 and ours.harden > 0
    assert (alone.steps, alone.adapt, alone.harden) == (ours.steps + ours.adapt + ours.harden, 0, 0)


@pytest.mark.parametrize(
    ("preset", "config"),
    [slow("cc_state", QUICK), ("cc_image", QUICK), slow("cc_image", ROOT / "configs/cheetah_quick.yaml")],
    ids=["cc_state", "cc_image", "cc_image, teacher on estimates"],
)
def test_a_correspondence_counts_its_steps_and_records_what_the_target_shows(preset, config, tmp_path):
    assert fit(tmp_path, preset, config, **(TEACHER_ALONE if config != QUICK else {})) == 0
    summary, ledger = results(tmp_path)
    assert summary["method"] == preset and summary["target_interactions"] == 60 + 60
    assert summary["result"] == summary["grounded"][-1]
    assert {e["purpose"] for e in ledger["entries"]} >= {"training", "evaluation"}
    for k in (0, 1):
        with h5py.File(tmp_path / f"step_0{k}/target.h5") as f:
            assert set(f["episode_0/observations"]) == {"pixels"} and "rewards" not in f["episode_0"]
    assert not list(tmp_path.glob("step_*/policy")) and not list(tmp_path.glob("step_*/dynamics"))
    assert main(["ledger", "--run", str(tmp_path)]) == 0
    assert "has not ended" not in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_a_correspondence_that_is_resumed_ends_with_the_same_numbers(tmp_path):
    assert fit(tmp_path, "cc_image") == 0
    before = results(tmp_path)[0]["grounded"]
    for done in ("step_01/evaluation.json", "step_01/visual/final.ckpt"):
        (tmp_path / done).unlink()
    assert main(["fit", "--config", str(tmp_path / "config.yaml")]) == 0
    assert results(tmp_path)[0]["grounded"] == before


def test_the_oracle_alone_trains_in_the_target_and_says_so(tmp_path):
    assert fit(tmp_path, "oracle") == 0
    summary, ledger = results(tmp_path)
    assert summary["result"] == summary["oracle"] > 0 and summary["target_interactions"] == 0
    assert {e["purpose"] for e in ledger["entries"]} == {"oracle reference", "evaluation of the oracle"}
    assert "has not ended" not in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("preset", "missing"),
    [slow("visual_only", "dynamics"), slow("no_state_reconstruction", None), slow("accumulate", None),
     slow("newest_data", None), slow("data_random", None), slow("paper_small", None)],
)  # fmt: skip
def test_an_ablation_runs_algorithm_1(preset, missing, tmp_path):
    learned = {"schedule__pretrain__estimator": 0, "schedule__finetune__estimator": 0}  # no stage of the encoder's own
    assert fit(tmp_path, preset, **(learned if preset == "paper_small" else {})) == 0
    summary, _ = results(tmp_path)
    assert summary["method"] == "idapt" and summary["result"] == summary["grounded"][-1]
    assert summary["target_interactions"] == 120
    assert missing is None or not list(tmp_path.glob(f"step_*/{missing}"))


@pytest.mark.slow
def test_policies_train_within_the_interval_of_what_was_found(tmp_path, monkeypatch):
    mass = {"nominal": 4.895, "estimate": 190.0, "ci95": [150.0, 240.0], "unit": "kg"}
    found = {"effect": "body_mass", "target": "pole", "parameters": {"mass": 190.0}}
    estimates = [{"effect": "body_mass", "target": "pole", "parameters": {"mass": mass}}]

    class Found:
        def to_dict(self):
            return {"effects": [found], "estimates": estimates}

    worlds = []

    def variants(distribution, source, number, seed):
        worlds.append(draw_variants(distribution, source, number, seed))
        return worlds[-1]

    monkeypatch.setattr("idapt_pl.stages.repair.discover_effects", lambda *args: Found())
    monkeypatch.setattr("idapt_pl.worlds.draw_variants", variants)
    assert fit(tmp_path, "dr_grounded", schedule__grounding_steps=0, side_by_side="false") == 0
    drawn = [[v.effects[-1].mass for v in made] for made in worlds if made]
    assert drawn and all(150 <= m <= 240 for made in drawn for m in made) and len(set(drawn[0])) == 3
    assert [made for made in worlds if not made], "before anything is found the source is what it is"
    summary = results(tmp_path)[0]
    assert summary["effects"] == [{"step": 0} | found] and summary["target_interactions"] == 60


@pytest.mark.parametrize("preset", [slow("data_expert"), slow("data_random_expert")])
def test_experts_explore_both_worlds_and_the_target_file_holds_images_alone(preset, tmp_path):
    assert fit(tmp_path, preset, schedule__grounding_steps=0) == 0
    assert (tmp_path / "step_00" / EXPERTS["expert"] / "final.ckpt").exists()
    with h5py.File(tmp_path / "step_00/target.h5") as f:
        assert set(f["episode_0/observations"]) == {"pixels"}
    assert results(tmp_path)[0]["target_interactions"] == 60


def test_backwards_data_want_a_task_with_a_direction(tmp_path, capsys):
    assert fit(tmp_path, "data_backwards") == 1
    assert "has no direction" in capsys.readouterr().err and not (tmp_path / "run.json").exists()


@pytest.mark.parametrize("preset", [slow("data_backwards"), slow("data_random_backwards_expert")])
def test_the_cheetah_explores_backwards(preset, tmp_path):
    config = QUICK.with_stem("cheetah_quick")
    small = {"schedule__grounding_steps": 0, "teacher__steps": 0, "teacher__rehearse": 0, "teacher__adapt": 0,
             "policy__memory": 0, "labels__members": 0, "effects__refine": "false"}  # fmt: skip
    assert fit(tmp_path, preset, config, **small) == 0
    stages = [s["stage"] for s in results(tmp_path)[0]["stages"]]
    assert EXPERTS["backwards"] in stages and stages.index(EXPERTS["backwards"]) < stages.index("target")


@pytest.mark.parametrize(("overrides", "says"), [
    ({"randomisation__ranges": "wider"}, "inverted_pendulum has: narrow, paper_narrow, wide, found"),
    ({"randomisation__ranges": "found"}, "this run finds no effects"),
    ({"randomisation__ranges": "[{effect: body_mass, target: pole, parameters: {mass: {uniform: [1]}}}]"},
     "uniform takes two ends"),
    ({"randomisation__ranges": "[{effect: body_mass, target: pile, parameters: {mass: 1}}]"}, "no body named 'pile'"),
    ({"randomisation__ranges": "[{effect: body_mas, target: pole}]"}, "unknown effect 'body_mas'"),
    ({"randomisation__variants": 0}, "randomisation.variants"),
    ({"method": "idapt", "policy__recurrent": 8}, "policy.recurrent is 8"),
])  # fmt: skip
def test_what_makes_no_sense_is_told_before_anything_is_written(overrides, says, tmp_path, capsys):
    assert fit(tmp_path / "run", "direct_transfer", **overrides) != 0
    assert says in capsys.readouterr().err and not (tmp_path / "run").exists()


def test_a_run_keeps_the_ranges_of_a_file(tmp_path, tiny_args):
    told = [{"effect": "body_mass", "target": "pole", "parameters": {"mass": {"uniform": [4.0, 6.0]}}}]
    (file := tmp_path / "ranges.yaml").write_text(yaml.safe_dump(told))
    cli = GroundingCLI(tiny_args(tmp_path / "run", randomisation__ranges=file), shows_bars=False)
    assert cli.config.randomisation.ranges == told  # the run folder needs no other file
    masses = [v.compile().body("pole").mass[0] for v in cli.run().worlds.variants]
    assert len(set(masses)) > 1 and all(4 <= m <= 6 for m in masses)


def test_a_file_that_is_called_found_is_none_of_ranges(tmp_path, tiny_args, monkeypatch):
    (tmp_path / "found").write_text("[]")
    monkeypatch.chdir(tmp_path)
    args = tiny_args(tmp_path / "run", randomisation__ranges="found", effects__discover="true")
    assert GroundingCLI(args, shows_bars=False).config.randomisation.ranges == "found"


def test_a_file_of_ranges_that_makes_no_sense_is_named(tmp_path, tiny_args, capsys):
    (file := tmp_path / "ranges.yaml").write_text(yaml.safe_dump([{"effect": "body_mas", "target": "pole"}]))
    assert main(["fit", *tiny_args(tmp_path / "run", randomisation__ranges=file)]) == 1
    assert f"{file}: entry 1: unknown effect 'body_mas'" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_the_names_of_methods_are_those_that_there_are():
    assert tuple(METHODS) == METHOD_NAMES


def test_a_policy_of_the_source_alone_is_exported_and_measured_like_any_other(tmp_path, capsys):
    run = tmp_path / "run"
    assert fit(run, "dr_narrow") == 0
    assert main(["evaluate", "--run", str(run), "--episodes", "2"]) == 0
    told = read_json(run / "evaluation_2_12345.json")
    assert list(told["policies"]) == ["direct transfer"]
    assert main(["export", "--run", str(run), "--out", str(tmp_path / "policy.onnx")]) == 0
    assert "source.h5" in capsys.readouterr().out


def test_what_cannot_be_exported_or_measured_again_says_so(tmp_path, capsys):
    assert fit(tmp_path / "recurrent", "adaptive_rl") == 0 and fit(tmp_path / "cc", "cc_state") == 0
    assert main(["export", "--run", str(tmp_path / "recurrent"), "--out", str(tmp_path / "policy.onnx")]) == 1
    assert "policy.recurrent cannot be exported" in capsys.readouterr().err
    assert main(["evaluate", "--run", str(tmp_path / "cc")]) == 1
    assert "what it reached is in its summary.json" in " ".join(capsys.readouterr().err.split())
