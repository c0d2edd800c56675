"""A regression of forces gives back what rubs and weighs, at joints and at a shaft that two of them turn."""

import mujoco
import numpy as np
import pytest

from idapt_pl.diagnosis.rounds.force_regression import ForceRegression
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.prediction.force_windows import MeasuredMotion

ARM = """
<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom size="0.1" mass="1"/>
<body pos="0 0 -0.3"><joint name="wrist" axis="0 1 0" damping="0.2"/><geom size="0.1" mass="1"/></body></body>
</worldbody>
<actuator><motor joint="elbow"/><motor joint="wrist"/></actuator></mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(ARM)
SHAFT = Candidate(
    SharedMotor,
    "elbow wrist",
    ("damping", "frictionloss", "armature"),
    (0.0,) * 3,
    (0.1,) * 3,
    fixed=(("ratio", -1.0),),
)
CAUSES = [
    (Candidate(JointDamping, "wrist", ("damping",), (0.2,), (0.1,)), np.array([0.5])),
    (Candidate(JointFrictionloss, "elbow", ("frictionloss",), (0.0,), (0.1,)), np.array([0.7])),
    (Candidate(JointArmature, "elbow", ("armature",), (0.0,), (0.1,)), np.array([0.04])),
    (SHAFT, np.array([0.3, 0.6, 0.02])),
]  # fmt: skip


def effects_of(causes):
    return [c.effect(x) for c, x in causes]


def lacking(motion):
    """What the nominal model lacks, by MuJoCo's inverse dynamics; dry friction as a sign, which it is at speed."""
    spec = mujoco.MjSpec.from_string(ARM)
    for e in effects_of(CAUSES):
        e.apply(spec)
    forces = []
    for model in (MODEL, spec.compile()):
        data, needed = mujoco.MjData(model), []
        for q, v, a in zip(motion.qpos, motion.qvel, motion.qacc, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            needed.append(data.qfrc_inverse.copy())
        forces.append(np.stack(needed))
    return forces[0] - forces[1]


@pytest.fixture
def moving():
    rng = np.random.default_rng(0)
    speed = rng.uniform(1.0, 3.0, (200, 2)) * rng.choice([-1, 1], (200, 2))
    motion = MeasuredMotion(np.arange(200.0), rng.normal(size=(200, 2)), speed, rng.normal(size=(200, 2)))
    return ForceRegression(MODEL, motion, lacking(motion))


def test_what_is_hidden_comes_back_and_nothing_is_left(moving):
    found = moving.fit([c for c, _ in CAUSES])
    for (c, x), (_, true) in zip(found, CAUSES, strict=True):
        np.testing.assert_allclose(x, true, rtol=0.05, atol=0.01, err_msg=c.label)
    assert np.sqrt(np.square(moving.left(found)).mean()) < 0.1 * np.sqrt(np.square(moving.lacking).mean())


def test_values_stay_inside_their_bounds(moving):
    (_, found), *_ = moving.fit([Candidate(JointDamping, "wrist", ("damping",), (0.2,), (0.1,), span=((0.0, 0.3),))])
    assert found == pytest.approx([0.3])


def test_nothing_is_said_of_what_never_moves_or_of_nothing():
    still = MeasuredMotion(np.arange(5.0), np.zeros((5, 2)), np.zeros((5, 2)), np.zeros((5, 2)))
    forces = ForceRegression(MODEL, still, np.ones((5, 2)))
    assert forces.fit([c for c, _ in CAUSES]) == [] and forces.fit([]) == []
    np.testing.assert_array_equal(forces.left([]), np.ones((5, 2)))
