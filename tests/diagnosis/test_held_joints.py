"""A joint that was locked, or set to one number by the map, is held; nothing else is."""

import json

import mujoco
import numpy as np
import pytest
from arm import ARM, record

from cli.main import main
from datamodules import Episode, Trajectories, write_trajectories
from idapt_pl.diagnosis.candidates.held_joints import hold_joints, hold_still_joints, release
from idapt_pl.diagnosis.candidates.listing import all_candidates
from idapt_pl.effects.candidate import TypicalSizes
from idapt_pl.effects.joints import JointFrictionloss

AT = 0.7
LOCKED = ARM.replace('<joint name="elbow" axis="0 1 0" damping="0.02"/>', "").replace(
    'pos="0 0 -0.3">', f'pos="0 0 -0.3" euler="0 {np.rad2deg(AT)} 0">'
).replace('<motor name="e" joint="elbow"/>', "")  # fmt: skip
STICKY = LOCKED.replace('damping="0.05"', 'damping="0.25"')


def with_elbow(data: Trajectories, velocities: bool = True, command: float = 0.0) -> Trajectories:
    """Recordings of the locked arm as a map with ``{constant: 0.7}`` makes them."""

    def beside(values: np.ndarray, constant: float) -> np.ndarray:
        return np.column_stack([values, np.full(len(values), constant)])

    made = []
    for e in data:
        seen = {"qpos": beside(e.observations["qpos"], AT)}
        if velocities:
            seen["qvel"] = beside(e.observations["qvel"], 0.0)
        made.append(Episode(beside(e.actions, command).astype(np.float32), seen))
    return Trajectories(tuple(made), data.dt)


@pytest.mark.parametrize("velocities", (pytest.param(True, marks=pytest.mark.slow), False))
def test_damping_of_the_shoulder_is_found_though_the_elbow_is_locked(tmp_path, velocities):
    """Without the lock the model's elbow swings, and no value of the shoulder explains its motion."""
    (tmp_path / "arm.xml").write_text(ARM)
    write_trajectories(tmp_path / "arm.h5", with_elbow(record(STICKY, episodes=12, velocities=velocities), velocities))
    out = tmp_path / "found"
    data = ["--model", str(tmp_path / "arm.xml"), "--data", str(tmp_path / "arm.h5"), "--out", str(out)]
    assert main(["diagnose", *data, "--quick", "--threads", "1"]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["held_joints"] == {"elbow": AT}
    (effect,) = report["effects"]
    assert (effect["effect"], effect["target"]) == ("joint_damping", "shoulder")
    assert effect["parameters"]["damping"]["estimate"] == pytest.approx(0.25, rel=0.05)
    patched = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    assert patched.neq == 0, "the lock is of the recordings, not of the robot"


def test_the_held_joint_stays_within_a_thousandth():
    spec = mujoco.MjSpec.from_string(ARM)
    assert hold_still_joints(spec, with_elbow(record(LOCKED, episodes=2))) == {"elbow": AT}
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 1.0, AT
    for _ in range(100):
        data.ctrl[0] = 1.0
        mujoco.mj_step(model, data)
    assert data.qpos[1] == pytest.approx(AT, abs=1e-3) and abs(data.qpos[0] - 1.0) > 0.1
    assert release(spec).compile().neq == 0


def test_nothing_is_looked_for_on_a_joint_that_is_held():
    spec, one = mujoco.MjSpec.from_string(ARM), np.ones(2)
    sizes = TypicalSizes(0.02, 0.1 * one, one, 0.5 * one, 6 * one, 0.5 * one, 2 * one, 0.2)
    assert {"elbow", "shoulder", "*"} <= {c.target for c in all_candidates(spec, sizes) if c.kind is JointFrictionloss}
    hold_joints(spec, {"elbow": AT})
    left = [c for c in all_candidates(spec, sizes) if c.kind.name.startswith(("joint_", "sensor_"))]
    assert {c.target for c in left} == {"shoulder"}, "nor one value for both"


def alone(**seen: np.ndarray) -> Trajectories:
    return Trajectories((Episode(np.zeros((9, 2), np.float32), seen),), 0.02)


def stuck() -> Trajectories:
    """An elbow that is told to move, and does not."""
    rng = np.random.default_rng(0)
    driven = (
        Episode(rng.normal(size=e.actions.shape).astype(np.float32), e.observations)
        for e in with_elbow(record(LOCKED, episodes=2))
    )
    return Trajectories(tuple(driven), 0.02)


NOT_HELD = {
    "both move": lambda: record(episodes=2),
    "driven, and stuck": stuck,
    "moves in one of two": lambda: Trajectories((*with_elbow(record(LOCKED, episodes=1)), *record(episodes=1)), 0.02),
    "nothing moves": lambda: alone(qpos=np.zeros((10, 2))),
    "another robot's": lambda: alone(qpos=np.zeros((10, 1))),
    "no positions": lambda: alone(pixels=np.zeros((10, 8, 8, 3), np.uint8)),
}


@pytest.mark.parametrize("name", NOT_HELD)
def test_nothing_else_is_held(name):
    spec = mujoco.MjSpec.from_string(ARM)
    assert hold_still_joints(spec, NOT_HELD[name]()) == {} and spec.compile().neq == 0
