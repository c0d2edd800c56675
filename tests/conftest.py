"""Small worlds, small nets and a small run, shared by the tests."""

from __future__ import annotations

import os
import shutil
import warnings
from pathlib import Path

os.environ["IDAPT_RENDERER"] = "classic"  # fast, and on every machine the same; Filament has tests of its own
os.environ.setdefault("OMP_NUM_THREADS", "1")  # nets are small here, and there is a test process for each core

import idapt_pl  # isort: skip  # sets the GL backend, and prepares torchvision, before mujoco and Lightning load
import lightning as L
import mujoco
import numpy as np
import pytest
import torch
import yaml
from filelock import FileLock

from cli.main import main
from datamodules import Episode, Trajectories
from idapt_pl.effects import Domain
from idapt_pl.effects.visual import CAMERA, CameraPose
from idapt_pl.tasks import Task

ROOT = Path(idapt_pl.__file__).parent.parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files beside this one first: whole runs are in them, and processes that share the files then end together."""
    items.sort(key=lambda item: item.path.parent != Path(__file__).parent)


CART = """
<mujoco><option timestep="0.01"/>
  <worldbody><light pos="0 0 3"/>
    <camera name="view" pos="0 -2 0" xyaxes="1 0 0 0 0 1"/>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="1"/>
      <geom name="box" type="box" size="0.2 0.2 0.2" mass="1" rgba="1 0 0 1"/></body>
  </worldbody>
  <actuator><motor name="push" joint="slide" ctrlrange="-100 100"/></actuator>
</mujoco>"""


class CartTask(Task):
    """A box on a rail; it ends beyond 0.5 m, or after 6 control steps. Reward: its position."""

    name, frame_skip, horizon = "cart", 2, 6

    def base(self):
        return mujoco.MjSpec.from_string(CART)

    def domains(self):
        source = Domain("source", self.base)
        pose = CameraPose(CAMERA, azimuth=80, elevation=-10, distance=2, lookat=(0, 0, 0))
        return {"source": source, "hard": Domain("hard", self.base, (pose,))}

    def reset(self, model, data, rng):
        data.qpos[:] = rng.uniform(-0.1, 0.1)

    def state(self, model, data):
        return np.concatenate([data.qpos, data.qvel])

    def outcome(self, model, data, action):
        return float(data.qpos[0]), bool(abs(data.qpos[0]) > 0.5)


@pytest.fixture
def cart():
    return CartTask()


def numbered_episodes(lengths, size=8, state=True, first=1):
    """Episodes whose frames, states and actions hold the episode's number and the time: (number, t, 0)."""
    episodes = []
    for number, T in enumerate(lengths, first):
        pixels = np.zeros((T + 1, size, size, 3), np.uint8)
        pixels[..., 0], pixels[..., 1] = number, np.arange(T + 1)[:, None, None]
        actions = np.stack([np.full(T, number), np.arange(T)], 1).astype(np.float32)
        observations = {"pixels": pixels}
        if state:
            observations["state"] = np.stack([np.full(T + 1, number), np.arange(T + 1)], 1).astype(np.float64)
        episodes.append(Episode(actions, observations))
    return Trajectories(tuple(episodes), 0.04, "numbered")


@pytest.fixture
def numbered():
    return numbered_episodes


@pytest.fixture
def trainer():
    """Makes a bare CPU Trainer for so many batches; with a ``history`` of all logged metrics."""

    class History(L.Callback):
        def __init__(self):
            self.rows = []

        def on_train_batch_end(self, trainer, *args):
            self.rows.append({k: float(v) for k, v in trainer.callback_metrics.items()})

    def make(batches):
        history = History()
        t = L.Trainer(
            accelerator="cpu",
            max_epochs=1,
            limit_train_batches=batches,
            log_every_n_steps=1,
            logger=False,
            callbacks=[history],
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        t.history = history.rows
        return t

    return make


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)
    np.random.seed(0)


# --- a run of Algorithm 1 in seconds ----------------------------------------------------------------

QUICK = ROOT / "configs" / "pendulum_quick.yaml"

TINY = {
    "image_size": 32, "render_processes": 0, "episodes": 2, "seed": 3, "oracle": "false", "effects.discover": "false",
    "schedule.until_settled": "false",
    "schedule.grounding_steps": 2, "schedule.images": 60, "schedule.source_images": 90, "schedule.interactions": 60,
    "schedule.source_policy": 16, "schedule.action_transformation": "true",
    **{f"schedule.{part}.{name}": n for part in ("pretrain", "finetune")
       for name, n in (("state_predictor", 3), ("visual", 2), ("policy", 12), ("dynamics", 1), ("estimator", 2))},
    "feeding.state_predictor_batch": 8, "feeding.visual_batch": 2, "feeding.num_envs": 2,
    "feeding.updates_per_step": 1, "feeding.policy_batch": 8, "feeding.warmup_steps": 10,
    "feeding.garat_envs": 2, "feeding.garat_rollout": 20, "feeding.trial_episodes": 1,
    "feeding.trial_repeats": 1,
    "vision.crop": 28,
    "policy.hidden": "[16]", "dynamics.hidden": "[16]",
    "visual.width": 4, "visual.blocks": 1, "visual.discriminator_width": 4,
    "dynamics.discriminator_batches": 2, "dynamics.epochs": 1,
    "trainer.accelerator": "cpu",
}  # fmt: skip


@pytest.fixture(scope="session")
def tiny_args():
    """Arguments of ``idapt fit`` for a tiny run in a folder; keywords override (``schedule__images=5``)."""

    def args(run_dir, **overrides):
        values = {**TINY, "run_dir": run_dir, **{k.replace("__", "."): v for k, v in overrides.items()}}
        return ["--config", str(QUICK), *(f"--{k}={v}" for k, v in values.items())]

    return args


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory, tiny_args, worker_id):
    """Folder of a tiny run that went from start to end: made once, a copy for each process of the tests."""
    folder = tmp_path_factory.mktemp("runs") / "uninterrupted"
    shared = tmp_path_factory.getbasetemp().parent / "shared_run" if worker_id != "master" else folder
    with FileLock(f"{shared}.building"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not (shared / "summary.json").exists():
            assert main(["fit", *tiny_args(shared)]) == 0
    if shared != folder:
        shutil.copytree(shared, folder)
        told = (folder / "config.yaml").read_text()
        (folder / "config.yaml").write_text(told.replace(str(shared), str(folder)))
    return folder


def tiny_config(**entries):
    """A config for a tiny run, nested as YAML has it; its encoder is supervised, as one that is exported is."""
    config: dict = {}
    for key, value in TINY.items():
        *parents, last = key.split(".")
        inside = config
        for parent in parents:
            inside = inside.setdefault(parent, {})
        inside[last] = yaml.safe_load(value) if isinstance(value, str) else value
    config["schedule"] |= {"grounding_steps": 1, "lengths": "given"}
    config["policy"]["encoder"] = "supervised"
    return config | entries
