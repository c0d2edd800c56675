"""Labels by replays: what actions decide is told, what starts decide is not, and encoders learn from what is told."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import TINY

from cli.main import main
from datamodules import Episode, ReplayBuffer, ReplayDataModule, Trajectories, read_trajectories, write_trajectories
from datamodules.stacks import FrameStacks
from idapt_pl.envs import VectorStateEnv
from idapt_pl.nets.encoder import Vision
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.stages.replay_agreement import agreement, warn_if_read_otherwise
from idapt_pl.stages.replayed_labels import agreed, play_again, replayed_labels
from idapt_pl.stages.settings import LabelSettings
from idapt_pl.tasks import make_task


def options(run, values):
    return [
        "--config",
        "configs/pendulum_quick.yaml",
        "--run_dir",
        str(run),
        *(f"--{k}={v}" for k, v in values.items()),
    ]


@pytest.fixture
def pendulum():
    task = make_task("inverted_pendulum")
    env = VectorStateEnv(task, task.domain("source"), 4)
    yield env
    env.close()


def pushes(episodes=6, steps=5):
    rng = np.random.default_rng(0)
    return [np.repeat(rng.uniform(-0.5, 0.5, (1, 1)), steps, 0).astype(np.float32) for _ in range(episodes)]


def test_what_starts_decide_is_not_told():
    rng = np.random.default_rng(0)
    by_actions = np.linspace(0, 1, 11)
    played = []
    for gain in (-1.0, 0.5, 2.0):
        by_chance = np.repeat(rng.standard_normal((24, 1)), 11, 1)
        played.append(np.stack([gain * by_actions + 0.01 * rng.standard_normal((24, 11)), by_chance], axis=2))
    states = agreed(played)
    for gain, s in zip((-1.0, 0.5, 2.0), states, strict=True):
        np.testing.assert_allclose(s[:, 0], gain * by_actions, atol=0.03)
    assert np.isnan(np.concatenate(states)[:, 1]).mean() > 0.8


def test_nothing_is_told_where_most_have_ended():
    simulations = np.random.default_rng(0).standard_normal((1, 6, 1)) + np.zeros((4, 6, 2))
    simulations[1:, 3:] = np.nan  # one of four goes on
    (states,) = agreed([simulations])
    np.testing.assert_allclose(states[:3], simulations[0, :3])
    assert np.isnan(states[3:]).all()


def test_a_simulation_that_ended_stays_ended(pendulum):
    states = play_again(pendulum, np.full((60, 1), 3.0, np.float32), seed=0)
    lasted = (~np.isnan(states[:, :, 0])).sum(1)
    assert (lasted < 61).all() and (lasted > 2).all()
    for s, n in zip(states, lasted, strict=True):
        assert np.isnan(s[n:]).all() and abs(s[n - 1, 1]) > 0.2 >= abs(s[n - 2, 1])  # its last state is the fallen one
    again = play_again(pendulum, np.full((60, 1), 3.0, np.float32), seed=0)
    np.testing.assert_array_equal(states, again)


def test_labels_are_where_a_target_like_the_source_is(pendulum, tmp_path):
    """Recovery: recordings of the same machine from other starts get the states that were recorded."""
    truths, episodes = [], []
    for i, actions in enumerate(pushes()):
        truth = play_again(pendulum, actions, seed=100 + i)[0]
        truths.append(truth)
        episodes.append(Episode(actions, {"pixels": np.zeros((len(truth), 8, 8, 3), np.uint8)}))
    write_trajectories(tmp_path / "target.h5", Trajectories(tuple(episodes), pendulum.dt))
    worlds = SimpleNamespace(training_states=lambda n: VectorStateEnv(pendulum.task, pendulum.domain, n))
    stages = Stages(tmp_path, cpu_trainer, 0)
    c = SimpleNamespace(worlds=worlds, stages=stages, labels=LabelSettings(replays=8))
    (path,) = replayed_labels(c, 0, [tmp_path / "target.h5"], None, None)
    labels = [e.observations["state"] for e in read_trajectories(path)]
    told, truth = np.concatenate(labels), np.concatenate(truths)
    known = ~np.isnan(told)
    assert known[:, 0].mean() > 0.5  # where the cart is, pushes decide
    spread = truth.std(0)
    assert np.mean(np.abs((told - truth) / spread)[known]) < 0.5
    assert replayed_labels(SimpleNamespace(labels=LabelSettings()), 0, [], None, None) == []


def test_gains_and_offsets_agree_and_turned_commands_do_not():
    rng = np.random.default_rng(0)
    labels = rng.standard_normal((300, 5))
    labels[::2, 1], labels[:270, 2], labels[:, 4] = np.nan, np.nan, 1.0
    readings = 0.6 * labels + 0.3 + 0.05 * rng.standard_normal(labels.shape)
    readings[np.isnan(readings)] = 9.0
    found = agreement(readings, labels, left_out=[3])
    assert (found[:2] > 0.99).all() and np.isnan(found[2:]).all()  # too few, left out, constant
    turned = agreement(readings, np.stack([labels[:, 3], -labels[:, 0]], axis=1))
    assert abs(turned[0]) < 0.2 and np.isnan(agreement(readings, np.full((300, 5), np.nan))).all()
    assert agreement(-readings, labels)[0] < -0.99


@pytest.mark.parametrize(("sign", "warned"), [(1, False), (-1, True)])
def test_a_target_that_goes_the_other_way_is_warned_of(tmp_path, caplog, sign, warned):
    rng = np.random.default_rng(0)
    shown = rng.integers(0, 255, (80, 1, 1, 3), np.uint8)
    states = (sign * shown[:, 0, 0].astype(np.float32) / 255) + 0.01 * rng.standard_normal((80, 3)).astype(np.float32)
    path = tmp_path / "replay_labelled.h5"
    write_trajectories(path, Trajectories((Episode(np.zeros((79, 1)), {"pixels": shown, "state": states}),), 0.1, ""))
    pi = SimpleNamespace(
        hparams=SimpleNamespace(frame_stack=1),
        encode=lambda pixels: torch.from_numpy(pixels[:, 0, 0, 0].astype(np.float32)),
    )
    c = SimpleNamespace(
        stages=Stages(tmp_path, cpu_trainer, 0), worlds=SimpleNamespace(task=SimpleNamespace(rates={2: 0}))
    )
    for _ in range(2):  # it is said again where a run goes on
        caplog.clear()
        warn_if_read_otherwise(c, 0, path, pi)
        assert ("labels.replays 0" in caplog.text) == warned
    told = c.stages.read(0, "replay_agreement")
    assert told["components"][2] is None and (told["median"] < -0.9) == warned


@pytest.mark.parametrize("rates", [{}, {3: 1}])
def test_what_is_not_told_teaches_nothing(rates):
    vision = Vision(rates="frames") if rates else Vision()
    torch.manual_seed(0)
    predictor = vision.predictor(32, 2, 4, rates, 0.1)
    images, state = torch.rand(5, 6, 32, 32), torch.randn(5, 4)
    half = state.clone()
    half[:, 0] = torch.nan
    error = predictor.error(images, half)
    error.backward()
    assert torch.isfinite(error)
    assert all(torch.isfinite(p.grad).all() for p in predictor.parameters() if p.grad is not None)
    assert error < predictor.error(images, state)
    assert predictor.error(images, torch.full((5, 4), torch.nan)) == 0


def test_half_of_the_images_are_labelled_ones():
    buffer = ReplayBuffer(8, 0)
    buffer.add({"pixels": np.zeros((8, 1, 4, 4, 3), np.uint8), "state": np.zeros((8, 2), np.float32)})
    given = Episode(np.zeros((5, 1)), {"pixels": np.full((6, 4, 4, 3), 9, np.uint8), "state": np.ones((6, 2))})
    feed = ReplayDataModule(None, buffer, 4, 1, 1, 3, 10, labelled=FrameStacks([given], 1, labels="state"))
    images = feed.images()
    assert images["pixels"].shape == (3, 10, 1, 4, 4, 3) and images["state"].shape == (3, 10, 2)
    assert (images["state"][:, :5] == 0).all() and (images["state"][:, 5:] == 1).all()
    assert (images["pixels"][:, :5] == 0).all() and (images["pixels"][:, 5:] == 9).all()


def test_one_replay_is_refused():
    with pytest.raises(ValueError, match=r"labels\.replays is 1: one alone agrees with itself"):
        LabelSettings(replays=1)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"policy.encoder": "learned", "schedule.pretrain.estimator": 0, "schedule.finetune.estimator": 0,
          "feeding.garat_start": "identity"}, "nothing learns from labels"),
        ({"policy.estimator_updates": 0, "schedule.pretrain.estimator": 0}, "nothing learns from labels"),
        ({"teacher.dagger": 0, "teacher.rehearse": 64, "teacher.steps": 8, "policy.memory": 8},
         "give members, such as 96"),
    ],
)  # fmt: skip
def test_where_nothing_would_learn_from_them_it_is_told_at_once(changed, message, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["fit", *options(run, TINY | {"labels.replays": 4} | changed)]) != 0
    assert message in capsys.readouterr().err and not (run / "step_00").exists()


def test_a_run_labels_what_it_records_through_F_too(tmp_path):
    run = tmp_path / "run"
    changed = {"labels.replays": 4, "schedule.action_transformation": True, "schedule.until_settled": False}
    assert main(["fit", *options(run, TINY | changed)]) == 0
    for step in ("step_00", "step_01"):
        labelled = read_trajectories(run / step / "replay_labelled.h5")
        states = np.concatenate([e.observations["state"] for e in labelled])
        assert 0 < np.isnan(states).mean() < 1
        assert (run / step / "estimator_replayed/final.ckpt").exists()
        assert (run / step / "replay_agreement.json").exists()
    assert (run / "step_01/dynamics/final.ckpt").exists()
    of_target = sum(len(read_trajectories(run / s / "target.h5").episodes) for s in ("step_00", "step_01"))
    assert len(labelled) == of_target, "step 1 labels all recordings so far"
