"""The guide's own robot as the source of a whole run, from its text to a grounded policy."""

import json

import numpy as np
import pytest
import yaml
from conftest import tiny_config
from test_own_tasks import GUIDE, URDF

from cli.main import main
from datamodules import read_trajectories

HEAVY = """

class Heavy(Reach):
    def base(self):
        spec = super().base()
        spec.body("rod").mass, spec.geoms[0].rgba = 3.0, [0.1, 0.4, 0.9, 1]
        return spec


def heavy() -> Task:
    return Heavy()
"""
"""What it is to be taken to: a rod of three times the mass, in another colour."""

KNOWN = [{"effect": "body_mass", "target": "rod", "parameters": {"mass": 1.5}}]
RANGES = [{"effect": "joint_damping", "target": "hinge", "parameters": {"damping": {"uniform": [0.0, 0.1]}}}]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_guides_robot_goes_through_a_grounding_step_with_known_effects_and_randomisation(tmp_path, monkeypatch):
    (tmp_path / "guides_robot.py").write_text(GUIDE + HEAVY)
    (tmp_path / "arm.urdf").write_text(URDF)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    own = {"task": "guides_robot:Reach", "target": {"task": "guides_robot:heavy", "name": "heavy arm"}}
    config = tiny_config(**own) | {"randomisation": {"ranges": RANGES, "variants": 3}}
    config["effects"]["known"] = KNOWN
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(config))
    run = tmp_path / "run"
    assert main(["fit", "--config", "my.yaml", "--run_dir", str(run)]) == 0

    summary = json.loads((run / "summary.json").read_text())
    assert (summary["task"], summary["target"], summary["target_interactions"]) == (
        "guides_robot:Reach", "heavy arm", 120,
    )  # fmt: skip
    returns = [summary["direct_transfer"], summary["visual_only"], *summary["grounded"]]
    assert len(returns) == 3 and all(-400 < value < 0 for value in returns), "100 steps, a few rad from the goal each"
    assert yaml.safe_load((run / "effects.yaml").read_text()) == KNOWN
    for k in (0, 1):
        source, target = (list(read_trajectories(run / f"step_0{k}/{name}.h5")) for name in ("source", "target"))
        assert all(set(e.observations) == {"pixels"} and e.rewards is None for e in target)
        assert sum(map(len, target)) == 60 and np.ptp(source[0].observations["state"][:, 0]) > 0.01
    assert (run / "step_01/dynamics/final.ckpt").exists() and (run / "step_01/policy/final.ckpt").exists()
    assert main(["ledger", "--run", str(run)]) == main(["report", "--run", str(run)]) == 0
