"""The configs in examples/: what they name is there, and source and target can be seen and moved."""

from contextlib import closing

import numpy as np
import pytest
from conftest import ROOT

from cli.fit import GroundingCLI

NEEDS = {"cartpole_pybullet": "pybullet", "pendulum_gymnasium": "pygame"}
EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.yaml"))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_ready_to_run(name, tmp_path, monkeypatch):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT / "examples")
    run = GroundingCLI([f"--config={ROOT / 'examples' / name}.yaml", f"--run_dir={tmp_path / 'run'}"]).run()
    schedule, most = run.grounding.schedule, 12_500 if "cheetah" in name else 5000
    assert schedule.images + schedule.grounding_steps * schedule.interactions <= most
    for env in (run.worlds.source(1), run.worlds.blind_target(0)):
        with closing(env):
            first = env.reset(seed=0)[0]["pixels"]
            for _ in range(3):
                obs, *_ = env.step(env.single_action_space.high[None] * 0.5)
            assert first.shape[-3:-1] == (run.config.image_size,) * 2
            assert np.abs(obs["pixels"][:, -1].astype(int) - first[:, -1]).max() > 30


def test_there_are_examples():
    assert {"cheetah_dm_control", "cartpole_dm_control", "cartpole_pybullet", "pendulum_gymnasium"} <= set(EXAMPLES)
