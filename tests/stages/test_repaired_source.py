"""Where step 0 finds effects, G and the encoder go on with what the repaired source shows of exploration."""

import json
import shutil

import mujoco
import numpy as np
import pytest
import torch

from cli.main import main
from datamodules.unpaired import read_all
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.run import Run
from idapt_pl.run_folder.results import newest_of
from idapt_pl.stages.repair import SourceRepair
from idapt_pl.tasks import make_task
from tests.conftest import TINY

HEAVY = BodyMass("pole", 40.0)
SETTINGS = TINY | {
    "schedule.repaired_visual": 4, "schedule.grounding_steps": 1, "schedule.pretrain.estimator": 4,
    "threads": 1, "side_by_side": "false",  # as runs are compared bit by bit
}  # fmt: skip
AGAIN = {f"repaired_{name}" for name in ("source.h5", "visual", "translated.h5", "estimator")}


def fit(folder, **others):
    config = ["--config", "configs/pendulum_quick.yaml", "--run_dir", str(folder)]
    return main(["fit", *config, *(f"--{key}={value}" for key, value in (SETTINGS | others).items())])


def finding(monkeypatch, effects):
    """Have step 0 find these effects, and later steps none."""
    monkeypatch.setattr(
        SourceRepair, "physical_effects", lambda self, k, *_: self._add(k, [e.to_dict() for e in effects if not k])
    )


@pytest.fixture(scope="module")
def repaired(tmp_path_factory):
    folder = tmp_path_factory.mktemp("repaired") / "run"
    with pytest.MonkeyPatch.context() as patch:
        finding(patch, [HEAVY])
        assert fit(folder) == 0
    return folder


def errors(path, domain):
    """How far each recorded state is from one control step of a domain out of the state before, with its action."""
    task, model = make_task("inverted_pendulum"), domain.compile()
    data, off = mujoco.MjData(model), []
    for episode in read_all([path], also="state"):
        states = episode.observations["state"].astype(float)
        for before, action, after in zip(states, episode.actions, states[1:], strict=False):
            data.qpos[:], data.qvel[:] = np.split(before, 2)
            task.play(model, data, action)
            off.append(np.abs(task.state(model, data) - after).max())
    return np.array(off)


def weights(folder, name):
    return torch.load(folder / f"step_00/{name}/final.ckpt", weights_only=True)["state_dict"]


def test_exploration_is_recorded_again_by_the_physics_of_the_repaired_source(repaired):
    plain = make_task("inverted_pendulum").domain("source")
    step = repaired / "step_00"
    assert errors(step / "source.h5", plain).max() < 1e-4
    assert errors(step / "repaired_source.h5", plain.with_effects(HEAVY)).max() < 1e-4
    assert np.median(errors(step / "repaired_source.h5", plain)) > 1e-3


def test_G_and_encoder_go_on_and_the_policy_sees_through_them(repaired):
    step = repaired / "step_00"
    assert {path.name for path in step.iterdir()} >= AGAIN
    first, again = weights(repaired, "visual"), weights(repaired, "repaired_visual")
    moved = [
        float((first[k] - again[k]).abs().max()) for k in first if k.startswith("G.") and first[k].is_floating_point()
    ]
    assert 0 < max(moved) < 0.1, "it goes on from the first one and does not begin anew"
    assert any(
        (weights(repaired, "estimator")[k] != v).any() for k, v in weights(repaired, "repaired_estimator").items()
    )
    translated = read_all([step / "repaired_translated.h5"], also="state").episodes[0]
    shown = read_all([step / "repaired_source.h5"], also="state").episodes[0]
    G = Run.open(repaired).load_visual(step / "repaired_visual/final.ckpt")
    assert (G.translate_episode(shown).observations["pixels"] == translated.observations["pixels"]).all()
    assert newest_of(step, "visual/final.ckpt") == step / "repaired_visual/final.ckpt"


def test_a_run_that_lost_what_came_after_ends_the_same(repaired, tmp_path, monkeypatch):
    finding(monkeypatch, [HEAVY])
    shutil.copytree(repaired, tmp_path / "run")
    for name in ("repaired_visual", "repaired_estimator", "policy"):
        shutil.rmtree(tmp_path / "run/step_00" / name)
    shutil.rmtree(tmp_path / "run/step_01")
    config = tmp_path / "run/config.yaml"
    config.write_text(config.read_text().replace(str(repaired), str(tmp_path / "run")))
    assert fit(tmp_path / "run") == 0
    for name in ("visual", "repaired_visual", "repaired_estimator", "policy"):
        mine, theirs = weights(tmp_path / "run", name), weights(repaired, name)
        assert all(torch.equal(mine[k], theirs[k]) for k in theirs), name


def test_later_steps_learn_from_the_repaired_exploration_and_the_report_shows_it(repaired, monkeypatch):
    stages = [s["stage"] for s in json.loads((repaired / "summary.json").read_text())["stages"] if s["step"] == 0]
    assert {"repaired_source", "repaired_visual", "repaired_estimator"} <= set(stages)
    assert not list((repaired / "step_01").glob("repaired_*"))
    shown = read_all([repaired / "step_01/translated.h5"], also="state").total_steps
    both = [
        read_all([repaired / path], also="state").total_steps
        for path in ("step_00/repaired_source.h5", "step_01/source.h5")
    ]
    assert shown == sum(both)


def test_where_nothing_is_found_nothing_is_explored_again(tmp_path, monkeypatch):
    finding(monkeypatch, [])
    assert fit(tmp_path / "run", **{"schedule.grounding_steps": 0}) == 0
    assert not list((tmp_path / "run/step_00").glob("repaired_*"))
