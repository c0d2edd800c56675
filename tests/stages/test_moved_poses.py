"""Poses that no motion brings about: labels that are true, joints that go their own ways, and what it is good for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch

from cli.main import main
from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from idapt_pl.envs import VectorImageEnv
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.images import stack_channels
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.stages import on_estimates, state_predictor
from idapt_pl.stages.moved_poses import KNOT, joint_spread, move, moved_poses, wandering
from idapt_pl.stages.schedule import StageLengths
from idapt_pl.stages.settings import PoseSettings
from idapt_pl.tasks import make_task

SIZE = 32


def falling(env, episodes=12, steps=8):
    """Episodes of a cart-pole in which the cart always runs the other way, as it does where nothing pushes it."""
    rng, made = np.random.default_rng(0), []
    for _ in range(episodes):
        angle = rng.uniform(-0.1, 0.1) * np.cosh(1.5 * env.dt * np.arange(steps + 1))
        rate = np.gradient(angle, env.dt)
        states = np.column_stack([-0.4 * angle, angle, -0.4 * rate, rate])
        made.append(recorded(env, states, np.zeros((steps, 1), np.float32)))
    return made


def recorded(env, states, actions):
    """What an environment shows in these states (T+1, 2 nq), of which all are positions and velocities."""
    frames, simulations = [], []
    for q, v in zip(*np.split(states, 2, 1), strict=True):
        frames.append(env.set_state(0, q, v))
        simulations.append(env._observe()["simulation"][0])
    shown = {"pixels": np.array(frames), "state": states.astype(np.float32), "simulation": np.array(simulations)}
    return Episode(actions, shown)


@pytest.fixture
def pendulum():
    task = make_task("inverted_pendulum")
    env = VectorImageEnv(task, task.domain("source"), image_size=SIZE, frame_stack=1, whole=True)
    env.reset(seed=0)
    yield env
    env.close()


def states_of(episodes):
    return np.concatenate([e.observations["state"] for e in episodes])


def test_offsets_go_straight_from_knot_to_knot_and_begin_at_rest():
    offsets, rates = wandering(35, 0.02, np.array([1.0, 0.0]), np.random.default_rng(0))
    assert (offsets[: KNOT + 1, 0] == offsets[0, 0]).all() and not rates[: KNOT + 1].any()
    assert np.allclose(np.diff(offsets, axis=0), rates[1:] * 0.02) and rates[KNOT + 1 :, 0].all()
    assert not offsets[:, 1].any()


def test_components_that_go_together_in_motion_part(pendulum):
    falls = falling(pendulum)
    moved = move(pendulum, falls, 1.0, 10_000, np.random.default_rng(0))
    assert len(moved) == len(falls)  # nothing is left after each once
    before, after = states_of(falls), states_of(moved)
    assert np.corrcoef(before[:, :2].T)[0, 1] < -0.999 and abs(np.corrcoef(after[:, :2].T)[0, 1]) < 0.8
    assert np.allclose(after[:, :2].std(0), before[:, :2].std(0) * np.sqrt(2), rtol=0.4)


def test_labels_are_what_the_images_show(pendulum):
    for episode in move(pendulum, falling(pendulum, steps=25), 1.0, 60, np.random.default_rng(0)):
        states = episode.observations["state"]
        for state, frame in zip(states, episode.observations["pixels"], strict=True):
            assert (pendulum.set_state(0, state[:2].astype(float), state[2:].astype(float)) == frame).all()
        speeds = np.diff(states[:, :2], axis=0) / pendulum.dt
        assert np.abs(speeds - (states[1:, 2:] + states[:-1, 2:]) / 2).max() < 0.3  # also where a knot lies between


def test_it_stops_when_there_are_enough(pendulum):
    moved = move(pendulum, falling(pendulum), 1.0, 20, np.random.default_rng(0))
    assert sum(len(e) + 1 for e in moved) == 27  # three episodes of nine


def test_the_way_that_a_robot_has_gone_stays():
    task = make_task("half_cheetah")
    env = VectorImageEnv(task, task.domain("source"), image_size=SIZE, frame_stack=1, whole=True)
    env.reset(seed=0)
    states = np.random.default_rng(0).normal(0, 0.1, (5, 2 * env.model.nv)) + np.eye(18)[0] * 1.5
    episode = recorded(env, states, np.zeros((4, 6), np.float32))
    moved = move(env, [episode], 1.0, 5, np.random.default_rng(0))[0]
    assert env.data[0].qpos[0] == pytest.approx(states[-1, 0])
    assert not np.allclose(moved.observations["state"], states[:, 1:], atol=0.05)
    env.close()


def test_what_lies_about_is_moved_too():
    """The puck, beside the hand that pushes it; the goal, which no joint moves, stays."""
    task = make_task("sawyer_push")
    env = VectorImageEnv(task, task.domain("source"), image_size=SIZE, frame_stack=1, whole=True)
    env.reset(seed=3)
    rng, shown = np.random.default_rng(0), []
    for _ in range(12):
        env.data[0].joint("puck").qpos[:2] += rng.normal(0, 0.05, 2)
        mujoco.mj_forward(env.model, env.data[0])
        shown.append({name: array[0] for name, array in env._observe().items()})
    episode = Episode(
        np.zeros((11, 2), np.float32), {n: np.array([s[n] for s in shown]) for n in ("state", "simulation")}
    )
    moved = move(env, [episode], 1.0, 1, rng)[0].observations["state"]
    before = episode.observations["state"]
    assert (moved[:, 25:28] == before[:, 25:28]).all(), "the goal"
    assert (np.abs(moved - before)[:, 28:30].max(0) > 0.01).all(), "the puck"
    env.close()


def test_the_spread_of_a_turned_body_is_an_angle():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    qpos = np.array([[0, 0, 0, np.cos(a / 2), 0, 0, np.sin(a / 2)] for a in (-0.2, 0.2)])
    assert joint_spread(model, qpos) == pytest.approx([0, 0, 0, 0, 0, 0.2], abs=1e-9)


def test_what_learned_from_them_reads_what_motion_never_showed(pendulum):
    """An angle is read off the pole, where it was read off the cart."""
    falls, rng = falling(pendulum, episodes=30), np.random.default_rng(1)
    seen = rng.uniform([-0.05, -0.1], [0.05, 0.1], (200, 2))
    frames = np.array([pendulum.set_state(0, q, np.zeros(2)) for q in seen])
    errors = {}
    for spread in (0.0, 1.0):
        moved = move(pendulum, falls, spread, 10_000, rng)
        net = fitted([*falls, *moved])
        with torch.no_grad():
            read = net.predict(torch.from_numpy(frames)[:, None]).numpy()
        errors[spread] = np.abs(read[:, 1] - seen[:, 1]).mean()
    assert errors[1.0] < 0.6 * errors[0.0], errors


def fitted(episodes):
    torch.manual_seed(0)
    pixels = torch.from_numpy(np.concatenate([e.observations["pixels"] for e in episodes]))[:, None]
    states = torch.from_numpy(states_of(episodes))
    net = Vision(strides=(2, 1, 1, 1), pool="keypoints").predictor(SIZE, 1, 4, {2: 0, 3: 1}, 0.04)
    net.fit_scale(states)
    adam = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(200):
        some = torch.randint(len(pixels), (32,))
        adam.zero_grad()
        net.error(stack_channels(pixels[some]), states[some]).backward()
        adam.step()
    return net


def test_none_are_made_unless_asked_for(tmp_path):
    context = SimpleNamespace(poses=PoseSettings())
    assert moved_poses(context, 0, [tmp_path / "not_even_read.h5"]) == []


def test_they_are_a_stage_of_the_run(pendulum, tmp_path):
    write_trajectories(tmp_path / "source.h5", Trajectories(tuple(falling(pendulum)), pendulum.dt, "falling"))
    worlds, stages = SimpleNamespace(source=lambda num_envs: pendulum), Stages(tmp_path, 0, cpu_trainer)
    context = SimpleNamespace(poses=PoseSettings(1.0, 20), worlds=worlds, stages=stages)
    (path,) = moved_poses(context, 0, [tmp_path / "source.h5"])
    made = read_trajectories(path)
    assert path.name == "moved.h5" and made.source.endswith("with every joint moved")
    assert made.total_steps + len(made) == 27
    assert moved_poses(context, 0, []) == [path], "a resumed run takes what there is"


def test_predictor_and_encoder_of_a_run_learn_from_them(tmp_path, tiny_args, monkeypatch):
    learned, plain = [], state_predictor.LabelledImages

    def watched(source, *rest):
        learned.append([f"{Path(path).parent.name}/{Path(path).name}" for path in source])
        return plain(source, *rest)

    monkeypatch.setattr(state_predictor, "LabelledImages", watched)
    run = tmp_path / "run"
    assert main(["fit", *tiny_args(run, poses__spread=0.5, poses__images=20, schedule__grounding_steps=0)]) == 0
    assert learned == [
        ["step_00/source.h5", "step_00/moved.h5"],
        ["step_00/translated.h5", "step_00/moved_translated.h5"],
    ]
    moved, shown = (read_trajectories(run / f"step_00/{name}.h5") for name in ("moved", "moved_translated"))
    assert (states_of(moved) == states_of(shown)).all() and 20 <= len(states_of(moved)) < 60
    assert any((a.observations["pixels"] != b.observations["pixels"]).any() for a, b in zip(moved, shown, strict=True))


def test_a_filter_learns_from_motions_alone(monkeypatch):
    learned = {"estimator": [], "filter": []}
    stages = {
        "rehearse": lambda c, step, name, *rest: name,
        "fit_encoder_on": lambda c, step, name, files, batches, pi: learned["estimator"].append(files) or pi,
        "fit_filter": lambda c, step, name, files, batches, pi: learned["filter"].append(list(files)) or pi,
        "take_over": lambda teacher, pi: None,
    }
    for name, stage in stages.items():
        monkeypatch.setattr(on_estimates, name, stage)
    on_estimates.in_rehearsals(None, 0, "", StageLengths(1, 1), ["known"], None, "pi", None, None, 1, ["poses"])
    assert learned["filter"] == [["known", "rehearsal_teacher"], ["known", "rehearsal_teacher", "rehearsal_policy"]]
    assert learned["estimator"] == [[*files, "poses"] for files in learned["filter"]]
