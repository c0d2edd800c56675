"""A recording that shows nothing new of how the target moves ends the run, and one that does goes on."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import TINY
from test_rollback import WhereTheCartIs, make_F, sample

from cli.main import main
from datamodules import write_trajectories
from idapt_pl.envs.ledger import Ledger
from idapt_pl.rl.collect import collect
from idapt_pl.stage import Stages
from idapt_pl.stages.convergence import Convergence, check_convergence
from idapt_pl.stages.rollback import distance_draws
from idapt_pl.targets import SimulatedTarget
from idapt_pl.worlds import Worlds


def test_samples_alike_are_at_the_floor_and_others_are_not():
    real = sample(300, 0.0, 1)
    same, other = distance_draws(real, [sample(900, 0.0, 2), sample(900, 0.5, 3)], 0)
    assert np.nanquantile(same[1:], 0.025) <= 0 < np.nanquantile(other[1:], 0.025)


def test_chance_alone_seldom_keeps_a_run_going():
    """Nominally 2.5 % of recordings that are alike seem different."""
    seem = 0
    for seed in range(60):
        (draws,) = distance_draws(sample(200, 0.0, 2 * seed + 1), [sample(600, 0.0, 2 * seed + 2)], seed)
        seem += bool(np.nanquantile(draws[1:], 0.025) > 0)
    assert seem <= 6


class Pushing:
    """A policy that pushes at random; it draws from torch's generator, as π does."""

    class actor:
        encoder = WhereTheCartIs()

        def __new__(cls, features, deterministic):
            return (200 * torch.rand(len(features), 1) - 100,)

    def encode(self, pixels):
        return self.actor.encoder.encode(torch.from_numpy(pixels))

    def begin(self, n):
        return None

    def remembering(self, features, memory):
        return features


@pytest.fixture
def context(cart, tmp_path):
    worlds = Worlds(
        cart,
        cart.domain("source"),
        SimulatedTarget(cart, cart.domain("source")),
        Ledger(tmp_path / "ledger.json"),
        32,
        2,
    )
    make = SimpleNamespace(dynamics=lambda encoder, **bounds: make_F())
    return SimpleNamespace(worlds=worlds, stages=Stages(tmp_path / "run", 0, None), make=make, batches=None)


def recorded(context, gain, path):
    """A recording of a target in which actions do so many times as much."""
    env, draw = context.worlds.source(1), np.random.default_rng(7)

    class Scaled:
        num_envs, dt = 1, env.dt

        def reset(self, **kwargs):
            return env.reset(**kwargs)

        def step(self, actions):
            return env.step(gain * actions)

    write_trajectories(
        path, collect(Scaled(), lambda p: draw.uniform(-100, 100, (1, 1)).astype(np.float32), 600, 3, "")
    )
    return path


@pytest.mark.parametrize(("gain", "settled"), [(1.0, True), (0.3, False)])
def test_a_target_that_moves_as_the_source_is_settled_and_another_is_not(context, tmp_path, gain, settled):
    found = check_convergence(context, 1, Pushing(), None, None, [recorded(context, gain, tmp_path / "target.h5")])
    assert found.settled == settled, found.sentence
    assert Convergence.from_dict(json.loads((tmp_path / "run/step_01/convergence.json").read_text())) == found


def test_a_settled_step_ends_the_run_with_the_policy_before(tiny_args, finished_run, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    shutil.copytree(finished_run / "step_00", run / "step_00")
    monkeypatch.setattr("idapt_pl.stages.convergence.residual_draws", lambda *a: np.zeros(10))
    assert main(["fit", *tiny_args(run, schedule__until_settled="true")]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert summary["settled"] == 1 and summary["grounded"] == [summary["visual_only"]]
    assert sorted(p.name for p in (run / "step_01").iterdir()) == ["convergence.json", "target.h5", "target.json"]
    assert not (run / "step_02").exists()
    assert summary["target_interactions"] == TINY["schedule.images"] + TINY["schedule.interactions"]
    assert "settled" in capsys.readouterr().out
    page = (run / "report.html").read_text()
    assert "nothing is left to learn" in page.lower() and "The run has not ended" not in page
