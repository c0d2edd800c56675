"""Algorithm 1 as a whole, tiny: what it leaves behind, its accounting, and exact resumption."""

import copy
import json
import os
import re
import shutil
import signal
from dataclasses import replace
from types import SimpleNamespace

import h5py
import lightning as L
import mujoco
import numpy as np
import pytest
import torch
import yaml
from conftest import TINY
from torch import nn
from torch.utils.data import DataLoader

from cli.fit import GroundingCLI
from cli.interrupt import Interrupted
from cli.main import main
from datamodules import read_trajectories, write_trajectories
from idapt_pl.effects import effect_from_dict
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.modules import StatePredictor
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.units import Units, give_in_units
from idapt_pl.run import Run
from idapt_pl.run_folder.shipped_configs import with_shipped_configs
from idapt_pl.stage import Stages, stage_seed
from idapt_pl.stages.repair import SourceRepair
from idapt_pl.stages.state_predictor import fit_P_S

STEPS = TINY["schedule.grounding_steps"]


def weights(checkpoint):
    return torch.load(checkpoint, weights_only=True)["state_dict"]


def assert_same_weights(a, b):
    a, b = weights(a), weights(b)
    assert a.keys() == b.keys()
    different = [k for k in a if not torch.equal(a[k], b[k])]
    assert different == []


def final_files(run):
    """Everything in a run folder that later commands read, relative."""
    wanted = ("final.ckpt", ".h5", "evaluation.json", "direct_transfer.json")
    return sorted(str(p.relative_to(run)) for p in run.rglob("*") if str(p).endswith(wanted))


# --- stages ---------------------------------------------------------------------------------------------


def test_stage_seed_is_stable_and_differs_by_run_step_and_stage():
    assert stage_seed(0, 1, "visual") == stage_seed(0, 1, "visual") == 2091422742
    seeds = {stage_seed(s, k, n) for s in range(5) for k in range(5) for n in ("visual", "policy", "dynamics")}
    assert len(seeds) == 75 and all(0 <= s < 2**31 for s in seeds)


class Regression(L.LightningModule):
    """Enough of a module for a stage; its batches come from the global generator, as dropout would."""

    def __init__(self, fail_at=None):
        super().__init__()
        self.fail_at, self.net = fail_at, nn.Linear(3, 1)

    def training_step(self, batch, index):
        if index == self.fail_at:
            raise RuntimeError("power failure")
        return (self.net(batch + torch.randn_like(batch)) - 1).square().mean()

    def configure_optimizers(self):
        return torch.optim.Adam(self.parameters(), lr=0.1)


class Ones(L.LightningDataModule):
    def train_dataloader(self):
        return DataLoader(torch.ones(40, 3), batch_size=4)


@pytest.fixture
def stages(tmp_path, trainer):
    def make(run):
        return Stages(tmp_path / run, 0, lambda folder, batches: trainer(batches))

    return make


def fit(stages, fail_at=None):
    return stages.fit(1, "toy", lambda: Regression(fail_at), lambda module, seed, device: Ones(), 10)


def test_a_stage_does_not_depend_on_what_ran_before_it(stages):
    first = fit(stages("a"))
    torch.rand(17)
    assert torch.equal(fit(stages("b")).net.weight, first.net.weight)


def test_a_stage_that_failed_half_way_starts_over_and_ends_the_same(stages):
    with pytest.raises(RuntimeError, match="power failure"):
        fit(stages("a"), fail_at=5)
    assert not (stages("a").folder(1) / "toy" / "final.ckpt").exists()
    assert torch.equal(fit(stages("a")).net.weight, fit(stages("b")).net.weight)


def test_a_finished_stage_is_loaded_and_not_fitted_again(stages):
    module = fit(stages("a"))
    again = fit(stages("a"), fail_at=0)
    assert torch.equal(again.net.weight, module.net.weight)


def test_recording_is_done_once_and_reports_the_files_own_count(stages, numbered):
    made = []

    def make(seed):
        made.append(seed)
        return numbered([4, 3])

    for _ in range(2):
        path, steps = stages("a").record(2, "target", make)
    assert made == [stage_seed(0, 2, "target")] and steps == 7 and read_trajectories(path).total_steps == 7


def test_time_is_counted_once_where_stages_run_side_by_side(stages):
    made = stages("a")
    for name, begin, end in (("one", 100, 110), ("beside", 102, 108), ("later", 109, 115), ("apart", 200, 201)):
        made.measure(0, name, lambda seed: {})
        path = made.folder(0) / f"{name}.json"
        path.write_text(json.dumps({"step": 0, "stage": name, "wall_s": end - begin}))
        os.utime(path, (end, end))
    assert made.elapsed() == pytest.approx(16)


# --- the whole loop -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def summary(finished_run):
    return json.loads((finished_run / "summary.json").read_text())


def test_summary_keeps_the_contract(summary):
    types = {
        "task": str, "target": str, "seed": int, "metric": str, "episodes": int, "wall_s": float,
        "direct_transfer": float, "grounded": list, "target_interactions": int, "stages": list,
    }  # fmt: skip
    assert {k: type(summary[k]) for k in types} == types
    assert summary["oracle"] is None, "not asked for"
    assert (summary["task"], summary["seed"]) == ("inverted_pendulum", TINY["seed"])
    assert summary["metric"] in ("return", "success") and summary["episodes"] == TINY["episodes"]
    assert len(summary["grounded"]) == STEPS and all(np.isfinite(summary["grounded"]))
    assert all(set(s) == {"step", "stage", "wall_s"} for s in summary["stages"])


def test_every_stage_of_algorithm_1_ran_in_every_grounding_step(summary):
    ran = {(s["step"], s["stage"]) for s in summary["stages"]}
    start = {
        "source",
        "target",
        "state_predictor",
        "source_policy",
        "direct_transfer",
        "visual",
        "translated",
        "estimator",
        "policy",
        "evaluation",
    }
    step = start - {"source_policy", "direct_transfer"} | {"dynamics"}
    assert ran == {(0, s) for s in start} | {(k, s) for k in range(1, STEPS + 1) for s in step}


def test_the_first_actions_of_the_target_are_played_again_in_the_source_for_pairs(tmp_path, tiny_args):
    lengths = {"schedule__paired_steps": 4, "schedule__grounding_steps": 1, "schedule__accumulate": "true"}
    assert main(["fit", *tiny_args(tmp_path, visual__reset_weight=2, **lengths)]) == 0
    recorded = [read_trajectories(tmp_path / f"step_0{k}/target.h5").episodes for k in (0, 1)]
    for k, target in ((0, recorded[0]), (1, recorded[0] + recorded[1])):
        again = read_trajectories(tmp_path / f"step_0{k}/replayed.h5").episodes
        assert len(again) == len(target)
        for here, there in zip(again, target, strict=True):
            assert "state" in here.observations and 0 < len(here) <= min(4, len(there))
            if k == 0:  # later F turns the actions
                assert np.array_equal(here.actions, there.actions[: len(here)])
    entries = json.loads((tmp_path / "ledger.json").read_text())["entries"]
    assert sum(e["count"] for e in entries if e["purpose"] == "training") == 120, "playing again costs nothing"


def test_target_interactions_are_those_of_the_files_and_of_the_schedule(finished_run, summary):
    in_files = 0
    for path in finished_run.glob("step_*/target.h5"):
        with h5py.File(path) as f:
            in_files += int(f.attrs["total_steps"])
    expected = TINY["schedule.images"] + STEPS * TINY["schedule.interactions"]
    ledger = json.loads((finished_run / "ledger.json").read_text())
    training = [e["count"] for e in ledger["entries"] if e["purpose"] == "training"]
    assert in_files == expected == sum(training) == ledger["training_total"] == summary["target_interactions"]


def test_exploration_of_the_source_may_be_longer(finished_run):
    """Its labelled images cost no target interaction."""
    with h5py.File(finished_run / "step_00/source.h5") as f:
        assert f.attrs["total_steps"] == TINY["schedule.source_images"] > TINY["schedule.images"]


def test_target_files_hold_images_and_actions_only_and_source_files_states_too(finished_run):
    for k in range(STEPS + 1):
        for name, observations in (("target", {"pixels"}), ("source", {"pixels", "state", "simulation"})):
            for e in read_trajectories(finished_run / f"step_{k:02d}/{name}.h5"):
                assert set(e.observations) == observations
                assert (e.rewards is None) == (name == "target")


def test_run_folder_holds_what_the_contract_lists(finished_run):
    for name in ("config.yaml", "run.json", "ledger.json", "summary.json"):
        assert (finished_run / name).stat().st_size > 0
    assert list(finished_run.rglob("events.out.tfevents*")) and list(finished_run.rglob("metrics.csv"))
    assert not list(finished_run.rglob("*.tmp"))
    provenance = json.loads((finished_run / "run.json").read_text())
    assert {"seed", "git_commit", "versions", "device"} <= set(provenance)


LEARNED = {
    "state_predictor": ("P_S.encoder.", "P_S.mlp."),
    "visual": ("G.", "G_back.", "D_T.", "D_S.", "P_T.encoder.convs.0."),
    "dynamics": ("actor.", "value.", "D."),
    "policy": ("actor.head.", "critic."),
}
"""Parts of each module that its stage trains."""


def begin_with(monkeypatch):
    """From now on, what the module of each stage is before its first batch, by step and stage."""
    begun = {}

    def watching(self, step, stage, build, feed, *args, original=Stages.fit):
        def watched(module, seed, device):
            data = feed(module, seed, device)  # which may set a start
            begun[step, stage] = {k: v.detach().clone() for k, v in module.state_dict().items()}
            return data

        return original(self, step, stage, build, watched, *args)

    monkeypatch.setattr(Stages, "fit", watching)
    return begun


def changed_parts(before, after, parts):
    """Which parts have a weight that is not what it was."""
    return {p for p in parts if any(not torch.equal(before[k], after[k]) for k in before if k.startswith(p))}


def told_in_units_of(after, begun):
    """A state predictor as it began, which tells the same states in the units of what it ended as."""
    told = copy.deepcopy(begun)
    last = max(n for n in told if n.startswith("P_S.mlp.") and n.endswith(".weight")).removesuffix(".weight")
    weight, bias = told[f"{last}.weight"], told[f"{last}.bias"]
    units = (Units(w["P_S.mean"][: len(weight)], w["P_S.std"][: len(weight)]) for w in (begun, after))
    give_in_units(weight, bias, *units)
    return told


def test_every_stage_changes_what_it_is_to_train_and_learning_rates_of_zero_change_nothing(
    finished_run, tiny_args, tmp_path, monkeypatch
):
    begun = begin_with(monkeypatch)
    frozen = {f"{key}__{rate}": 0 for key, rate in (
        ("state_predictor", "lr"), ("visual", "lr_generator"), ("visual", "lr_discriminator"), ("dynamics", "lr"),
        ("dynamics", "lr_discriminator"), ("policy", "lr"),
    )}  # fmt: skip
    for name, rates in (("learning", {}), ("frozen", frozen)):
        run = tmp_path / name
        shutil.copytree(finished_run / "step_00", run / "step_00")
        settings = {"schedule__grounding_steps": 1, "feeding__trial_episodes": 0, "feeding__trial_repeats": 0}
        settings |= {"feeding__garat_start": "identity"}
        assert main(["fit", *tiny_args(run, **settings, **rates)]) == 0
        for stage, parts in LEARNED.items():
            after = weights(run / f"step_01/{stage}/final.ckpt")
            before = told_in_units_of(after, begun[1, stage]) if stage == "state_predictor" else begun[1, stage]
            changed = changed_parts(before, after, parts)
            assert changed == (set(parts) if name == "learning" else set()), f"{stage}, {name}"


def test_the_policy_sees_with_the_estimator_that_was_fitted_to_what_G_shows(finished_run):
    for k in range(STEPS + 1):
        estimator, policy = (weights(finished_run / f"step_{k:02d}/{s}/final.ckpt") for s in ("estimator", "policy"))
        fitted = {n.removeprefix("P_S."): v for n, v in estimator.items()}
        assert all(torch.equal(policy[f"actor.encoder.{n}"], v) for n, v in fitted.items())
        source, seen = (read_trajectories(finished_run / f"step_{k:02d}/{n}.h5") for n in ("source", "translated"))
        pairs = list(zip(reversed(source.episodes), reversed(seen.episodes), strict=False))  # the newest come last
        assert pairs and all(np.array_equal(a.observations["state"], b.observations["state"]) for a, b in pairs)
        assert any(not np.array_equal(a.observations["pixels"], b.observations["pixels"]) for a, b in pairs)


def test_what_a_run_writes_is_json_to_other_languages_too(finished_run):
    def refuse(constant):
        raise ValueError(f"{constant} is none of JSON's values")

    written = list(finished_run.rglob("*.json"))
    assert len(written) > 3
    for path in written:
        json.loads(path.read_text(), parse_constant=refuse)


@pytest.mark.parametrize(("returns", "kept"), [((7.0, 3.0), "before"), ((3.0, 7.0), "after"), ((5.0, 5.0), "after")])
def test_a_policy_that_does_worse_in_the_grounded_source_after_its_training_is_put_back(
    finished_run, tiny_args, tmp_path, monkeypatch, returns, kept
):
    begun, answers = begin_with(monkeypatch), iter(returns)
    monkeypatch.setattr("idapt_pl.stages.trials.evaluate", lambda *a, **k: SimpleNamespace(mean=next(answers)))
    run = tmp_path / "run"
    shutil.copytree(finished_run / "step_00", run / "step_00")
    shutil.rmtree(run / "step_00/policy")
    assert main(["fit", *tiny_args(run, schedule__grounding_steps=0, feeding__trial_repeats=0)]) == 0
    after, parts = weights(run / "step_00/policy/final.ckpt"), LEARNED["policy"]
    assert changed_parts(begun[0, "policy"], after, parts) == (set() if kept == "before" else set(parts))
    told = json.loads((run / "step_00/policy/stage.json").read_text())
    assert (told["trial_before"], told["trial_after"], told["kept"]) == (*returns, kept)


@pytest.mark.parametrize(
    ("answers", "attempts", "kept"),
    [((0.0, 0.5, 900.0), 2, "after"), ((0.5, 0.0, 0.0), 2, "before"), ((0.0, 900.0), 1, "after")],
)
def test_a_policy_that_falls_short_of_the_source_policy_trains_again_in_the_same_stage(
    finished_run, tiny_args, tmp_path, monkeypatch, answers, attempts, kept
):
    returns, run = iter(answers), tmp_path / "run"
    monkeypatch.setattr("idapt_pl.stages.trials.evaluate", lambda *a, **k: SimpleNamespace(mean=next(returns)))
    shutil.copytree(finished_run / "step_00", run / "step_00")
    shutil.rmtree(run / "step_00/policy")
    assert json.loads((run / "step_00/source_policy/stage.json").read_text())["trial_after"] > 1
    assert main(["fit", *tiny_args(run, schedule__grounding_steps=0, feeding__trial_repeats=1)]) == 0
    told = json.loads((run / "step_00/policy/stage.json").read_text())
    assert (told["attempts"], told["kept"]) == (attempts, kept) and "again" not in told
    assert not list(returns), "each attempt was tried, and no other"


@pytest.mark.slow
def test_without_finetuning_G_keeps_the_P_T_that_was_trained_with_it(finished_run, tiny_args, tmp_path):
    run = tmp_path / "kept"
    shutil.copytree(finished_run / "step_00", run / "step_00")
    overrides = {"schedule__finetune__visual": 0, "schedule__finetune__estimator": 0, "schedule__grounding_steps": 1}
    assert main(["fit", *tiny_args(run, **overrides)]) == 0
    assert_same_weights(run / "step_00/visual/final.ckpt", run / "step_01/visual/final.ckpt")
    assert not (run / "step_01/estimator").exists()


def test_rerunning_a_finished_run_changes_nothing(finished_run, tiny_args):
    def contents():
        return {p: p.read_bytes() for p in finished_run.rglob("*") if p.is_file() and p.name not in ("run.json",)}

    before = contents()
    assert main(["fit", *tiny_args(finished_run)]) == 0
    after = contents()
    assert before.keys() == after.keys()
    assert [p.name for p in before if before[p] != after[p]] == []


def test_run_json_keeps_what_a_run_was_started_with_and_adds_every_later_start(finished_run, tiny_args, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    (run / "config.yaml").write_text((run / "config.yaml").read_text().replace(str(finished_run), str(run)))
    (run / "run.json").write_text(json.dumps({"started": "once", "git_commit": "abc"}))
    for _ in range(2):
        assert main(["fit", *tiny_args(run)]) == 0
    kept = json.loads((run / "run.json").read_text())
    assert (kept["started"], kept["git_commit"]) == ("once", "abc")
    assert [set(r) >= {"started", "git_commit", "versions"} for r in kept["resumed"]] == [True, True]


def test_opening_a_run_puts_the_effects_it_discovered_into_its_source(finished_run, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    hidden = {"effect": "body_mass", "target": "pole", "parameters": {"mass": 33.0}}
    (run / "step_01/effects.json").write_text(json.dumps({"effects": [hidden]}))
    source = Run.open(run).worlds.source_domain.compile()
    assert source.body("pole").mass[0] == pytest.approx(33.0)
    refined = hidden | {"parameters": {"mass": 44.0}}
    (run / "step_01/known_start_search.json").write_text(json.dumps({"effects": [refined]}))
    source = Run.open(run).worlds.source_domain.compile()
    assert source.body("pole").mass[0] == pytest.approx(44.0), "what a search from known starts found comes last"
    assert Run.open(finished_run).worlds.source_domain.compile().body("pole").mass[0] != pytest.approx(33.0)


def test_the_summary_tells_of_effects_as_they_were_refined(finished_run, tiny_args, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    (run / "config.yaml").write_text((run / "config.yaml").read_text().replace(str(finished_run), str(run)))
    for name, mass in (("effects", 33.0), ("known_start_search", 44.0)):
        found = [{"effect": "body_mass", "target": "pole", "parameters": {"mass": mass}}]
        written = {"step": 1, "stage": name, "wall_s": 1.0, "effects": found}
        (run / f"step_01/{name}.json").write_text(json.dumps(written))
    assert main(["fit", *tiny_args(run)]) == 0
    assert [e["parameters"]["mass"] for e in json.loads((run / "summary.json").read_text())["effects"]] == [44.0]


@pytest.mark.slow
def test_the_loop_judges_effects_by_forecasts_where_images_do_not_tell_speeds(finished_run, tmp_path, monkeypatch):
    """Hardly trained estimators do not. The whole way through: images of the target, G, the sensor, the run folder."""
    monkeypatch.setattr("idapt_pl.image_diagnosis.forecasts.FORECAST_EPISODES", 4)
    monkeypatch.setattr("idapt_pl.image_diagnosis.forecasts.FORECAST_STEPS", 8)
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    ledger = (run / "ledger.json").read_text()
    opened = Run.open(run)
    settings = DiscoverySettings(True, candidates=("body_mass",), max_effects=1)
    repair = SourceRepair(opened.context, settings, opened.grounding.record_control)
    pi = opened.load_policy(run / "step_00/policy/final.ckpt")
    repaired = repair.physical_effects(0, [run / "step_00/target.h5"], opened.load_visual(), pi)
    found = json.loads((run / "step_00/effects.json").read_text())
    assert found["forecasts"] and np.isfinite([found["before"], found["after"], found["excess"]]).all()
    assert set(found["target"]) == {"slider", "hinge", "slider velocity", "hinge velocity"} == set(found["control"])
    assert repaired == bool(found["effects"]) and yaml.safe_load((run / "effects.yaml").read_text()) == found["effects"]
    assert (run / "ledger.json").read_text() == ledger, "no further step in the target"


@pytest.mark.slow
def test_visual_effects_are_added_before_anything_is_learned_and_stay_when_the_run_is_opened(
    tmp_path, tiny_args, capsys
):
    run = tmp_path / "run"
    assert (
        main(["fit", *tiny_args(run), "--effects.looks", "true", "--target", "easy", "--schedule.grounding_steps", "0"])
        == 0
    )
    found = json.loads((run / "step_00/looks.json").read_text())
    assert found["after"] < found["before"] and found["effects"]
    source = Run.open(run).worlds.source_domain
    assert [e.to_dict() for e in source.effects[-len(found["effects"]) :]] == found["effects"]
    for path in (run / "effects.yaml", run / "step_00/effects.yaml"):
        assert yaml.safe_load(path.read_text()) == found["effects"]
    assert json.loads((run / "summary.json").read_text())["effects"] == [{"step": 0} | e for e in found["effects"]]
    printed = " ".join(capsys.readouterr().out.split())
    assert "source repaired" in printed and f"in step 0: {found['effects'][0]['effect']} of" in printed
    report = (run / "report.html").read_text()
    assert "visual grounding, source repaired" in report and "Step 0: G, and effects" in report
    assert "visual effects below" in report and found["estimates"][0]["effect"] in report


IMAGES = ["--candidates", "body_mass", "--max-effects", "1", "--seed", "0"]


def test_a_recording_of_images_alone_is_diagnosed_with_the_estimator_of_a_run(finished_run, tmp_path, monkeypatch):
    monkeypatch.setattr("idapt_pl.image_diagnosis.calibration.VELOCITY_ERROR_LIMIT", np.inf)
    data, out = finished_run / "step_00/target.h5", tmp_path / "diagnosis"
    assert main(["diagnose", "--data", str(data), "--run", str(finished_run), "--out", str(out), *IMAGES]) == 0
    report = json.loads((out / "report.json").read_text())
    assert set(report["error"]["per_channel"]) == {"slider", "hinge"}, "positions read from images, no velocities"
    assert (out / "report.html").stat().st_size > 0


def test_where_its_sensor_is_vague_a_recording_of_images_is_diagnosed_by_forecasts(finished_run, tmp_path, capsys):
    """An estimator that hardly learned anything cannot tell how fast things move."""
    data, out = finished_run / "step_00/target.h5", tmp_path / "diagnosis"
    args = ["diagnose", "--data", str(data), "--run", str(finished_run), "--out", str(out), *IMAGES]
    assert main(args) == 0
    report, source = json.loads((out / "report.json").read_text()), Run.open(finished_run).worlds.source_domain
    assert report["error"]["metric"].startswith("energy score") and report["error"]["noise_floor"] > 0
    assert set(report["error"]["per_channel"]) == {"slider", "hinge", "slider velocity", "hinge velocity"}
    found = yaml.safe_load((out / "effects.yaml").read_text())
    assert (report["verdict"] == "effects_found") == bool(found) == bool(report["effects"])
    patched = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    repaired = source.with_effects(*map(effect_from_dict, found)).compile()
    assert patched.body_mass == pytest.approx(repaired.body_mass, rel=1e-4)
    page = (out / "report.html").read_text()
    assert "<svg" in page and "read of the target" in page and "A typical episode" in page
    assert "energy score" in capsys.readouterr().out
    assert list(out.glob("events.out.tfevents.*"))
    assert main([*args, "--fit", "0"]) == 1
    assert "leave --fit and --hold-out away" in " ".join(capsys.readouterr().err.split())


def test_a_recording_of_images_of_another_size_is_refused(finished_run, tmp_path, capsys):
    """Networks would look at their middle, and read something else."""
    recorded, data = read_trajectories(finished_run / "step_00/target.h5"), tmp_path / "wide.h5"
    pixels = [np.pad(e.observations["pixels"], ((0, 0), (2, 2), (4, 4), (0, 0))) for e in recorded]
    wide = tuple(replace(e, observations={"pixels": p}) for e, p in zip(recorded, pixels, strict=True))
    write_trajectories(data, replace(recorded, episodes=wide))
    assert main(["diagnose", "--data", str(data), "--run", str(finished_run), "--out", str(tmp_path / "out")]) == 1
    said, (height, width) = " ".join(capsys.readouterr().err.split()), pixels[0].shape[1:3]
    assert f"{height}x{width}" in said and "target.h5" in said and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_looks_of_a_recording_are_compared_with_what_the_source_of_a_run_shows(finished_run, tmp_path, capsys):
    data, out = finished_run / "step_00/source.h5", tmp_path / "seen"
    options = ["--looks", "--candidates", "body_mass", "--max-effects", "1"]
    assert main(["diagnose", "--data", str(data), "--run", str(finished_run), "--out", str(out), *options]) == 0
    assert yaml.safe_load((out / "looks.yaml").read_text()) == [], "the source looks like itself"
    assert (out / "looks.png").read_bytes().startswith(b"\x89PNG")
    assert "none was found" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(["diagnose", "--data", str(data), "--model", "m.xml", "--out", str(out), "--looks"])


def test_a_run_of_a_version_that_did_not_know_some_keys_is_resumed_with_their_defaults(
    finished_run, tiny_args, tmp_path
):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    config = yaml.safe_load((run / "config.yaml").read_text())
    del config["visual"]["channels_last"], config["effects"], config["feeding"]["garat_ridge"]
    (run / "config.yaml").write_text(yaml.safe_dump(config | {"run_dir": str(run)}))
    (run / "run.json").unlink()  # such a version kept no config in it
    assert main(["fit", *tiny_args(run)]) == 0
    assert yaml.safe_load((run / "config.yaml").read_text())["visual"]["channels_last"] is False


def test_a_run_of_a_version_that_had_more_keys_is_resumed_and_opened(finished_run, tmp_path, capsys):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    config = yaml.safe_load((run / "config.yaml").read_text()) | {"run_dir": str(run)}
    config["policy"]["estimator_jitter"], config["schedule"]["source_actions"] = 0.0, "policy"
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    Run.open(run)
    assert main(["fit", "--config", str(run / "config.yaml")]) == 0
    assert not {"estimator_jitter", "source_actions"} & set(re.findall(r"\w+", (run / "config.yaml").read_text()))
    config["policy"]["estimator_jitter"] = 0.3  # it did something
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    assert main(["fit", "--config", str(run / "config.yaml")]) != 0
    assert "estimator_jitter" in capsys.readouterr().err


def test_the_kept_config_alone_resumes_the_run(finished_run):
    before = (finished_run / "summary.json").read_bytes()
    assert main(["fit", "--config", str(finished_run / "config.yaml")]) == 0
    assert (finished_run / "summary.json").read_bytes() == before


def test_another_config_in_the_same_run_folder_is_refused_by_name_and_changes_nothing(finished_run, tiny_args, capsys):
    before = (finished_run / "config.yaml").read_text()
    assert main(["fit", *tiny_args(finished_run, schedule__interactions=61)]) == 1
    error = capsys.readouterr().err
    assert "schedule.interactions" in error and str(finished_run) in error and "Traceback" not in error
    assert (finished_run / "config.yaml").read_text() == before


def kill_after_one(monkeypatch):
    """From now on, the first thing that a run completes is the last."""

    def killing(original):
        def wrapped(self, step, stage, *args, **kwargs):
            folder = self.folder(step)
            done = [folder / stage / "final.ckpt", folder / f"{stage}.h5", folder / f"{stage}.json"]
            was_done = any(p.exists() for p in done)
            result = original(self, step, stage, *args, **kwargs)
            if not was_done:
                raise Interrupted(signal.SIGINT)
            return result

        return wrapped

    for name in ("fit", "record", "measure"):
        monkeypatch.setattr(Stages, name, killing(getattr(Stages, name)))


@pytest.mark.slow
def test_a_run_killed_after_every_single_stage_ends_bitwise_like_the_uninterrupted_one(
    finished_run, tiny_args, tmp_path, monkeypatch
):
    run, killed = tmp_path / "killed", 0
    with monkeypatch.context() as patch:
        kill_after_one(patch)
        while main(["fit", *tiny_args(run)]) != 0:
            killed += 1
            assert killed < 100, "the run makes no progress"
    assert killed == 10 + 9 * STEPS
    assert final_files(run) == final_files(finished_run)
    for name in final_files(run):
        if name.endswith(".ckpt"):
            assert_same_weights(run / name, finished_run / name)
    ledger = [json.loads((r / "ledger.json").read_text()) for r in (run, finished_run)]
    assert ledger[0] == ledger[1]


@pytest.mark.slow
def test_a_run_whose_last_step_was_lost_repeats_it_bitwise(finished_run, tiny_args, tmp_path):
    run, last = tmp_path / "run", f"step_{STEPS:02d}"
    shutil.copytree(finished_run, run)
    shutil.rmtree(run / last)
    config = (run / "config.yaml").read_text().replace(str(finished_run), str(run))
    (run / "config.yaml").write_text(config)
    assert main(["fit", *tiny_args(run)]) == 0
    assert_same_weights(run / last / "policy/final.ckpt", finished_run / last / "policy/final.ckpt")


def test_a_learned_encoder_cannot_be_regressed_on_states_which_is_said_at_once(tiny_args, tmp_path, capsys):
    assert main(["fit", *tiny_args(tmp_path / "run", policy__encoder="learned")]) == 1
    assert "schedule.pretrain.estimator is 2 batches, but policy.encoder is learned" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            {"schedule__paired_steps": 4, "visual__reset_weight": 0},
            "paired_steps is 4, but G learns nothing from pairs",
        ),
        ({"schedule__finetune__dynamics": 0}, "F would be used untrained"),
        ({"shorten": 0.5}, "shorten"),
    ],
)
def test_settings_that_would_do_nothing_are_refused(tiny_args, tmp_path, capsys, settings, said):
    assert main(["fit", *tiny_args(tmp_path / "run", **settings)]) == 1
    assert said in capsys.readouterr().err and not (tmp_path / "run/step_00").exists()


def test_a_shortened_config_keeps_every_stage_that_it_has_and_gets_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = {"image_size": 32, "vision.crop": 28, "render_processes": 0, "effects.discover": "false", "episodes": 2}
    options |= {"visual.width": 4, "visual.blocks": 1, "trainer.accelerator": "cpu", "schedule.until_settled": "false"}
    arguments = ["--config", "configs/pendulum_quick.yaml", *(f"--{k}={v}" for k, v in options.items())]
    cli = GroundingCLI([*with_shipped_configs(arguments), "--shorten=1000"])
    config = cli.config
    assert cli.shortened_by == 1000
    assert (
        config.schedule.pretrain.visual == 20 and config.schedule.images == 300 and config.schedule.grounding_steps == 1
    )
    assert config.shorten == 1 and config.run_dir == "runs/inverted_pendulum_hard_0_short"
    assert config.schedule.finetune.visual == 0, "what a config has not is not begun"


def test_encoders_of_policies_learn_in_other_lights_and_P_S_does_not():
    sizes = {"state_dim": 2, "image_size": 32, "frame_stack": 3, "vision": Vision(crop=28)}
    stages = SimpleNamespace(fit=lambda step, name, build, *rest: build())
    context = SimpleNamespace(
        make=SimpleNamespace(state_predictor=StatePredictor), stages=stages,
        worlds=SimpleNamespace(dimensions=sizes, frame_stack=3), batches=SimpleNamespace(state_predictor_batch=2),
    )  # fmt: skip
    assert fit_P_S(context, 0, [], 1).hparams.relight == 0
    assert fit_P_S(context, 0, [], 1, StatePredictor(**sizes, relight=0.7)).hparams.relight == 0.7


@pytest.mark.slow
def test_same_seed_same_run_and_another_seed_another(finished_run, tiny_args, tmp_path):
    last = f"step_{STEPS:02d}/policy/final.ckpt"
    assert main(["fit", *tiny_args(tmp_path / "same")]) == 0
    assert_same_weights(tmp_path / "same" / last, finished_run / last)
    assert main(["fit", *tiny_args(tmp_path / "other", seed=4)]) == 0
    a, b = weights(tmp_path / "other" / last), weights(finished_run / last)
    assert any(not torch.equal(a[k], b[k]) for k in a)


@pytest.mark.slow
def test_ablations_run(tiny_args, tmp_path):
    """Without F, on the newest data only, with an encoder learned by SAC alone, and with the oracle reference."""
    run = tmp_path / "ablation"
    overrides = {
        "schedule__grounding_steps": 1,
        "schedule__action_transformation": "false",
        "schedule__accumulate": "false",
    }
    assert main(["fit", *tiny_args(run, **overrides, oracle="true")]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert summary["oracle"] is not None and not (run / "step_01/dynamics").exists()
    assert summary["target_interactions"] == TINY["schedule.images"] + TINY["schedule.interactions"]
    assert main(["ledger", "--run", str(run)]) == 0, "the oracle's interactions too are those of its files"
    paper = {
        "schedule__grounding_steps": 1,
        "policy__encoder": "learned",
        "feeding__garat_start": "identity",
        "schedule__pretrain__estimator": 0,
        "schedule__finetune__estimator": 0,
    }
    assert main(["fit", *tiny_args(tmp_path / "paper", **paper)]) == 0
