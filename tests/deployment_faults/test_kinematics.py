"""Which velocity belongs to which position."""

import numpy as np
import pytest

from idapt_pl.deployment_faults.forecast import Signals
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.kinematics import compare_velocities

JOINTS = ScalarJoints(("a", "b"), (0, 1), (0, 1), (True, True), ((), ()))


def moved(together, swapped=False):
    """Two joints for 20 s: b moves as ``together`` times a, or by itself."""
    time, rng = 0.02 * np.arange(1001), np.random.default_rng(0)
    a = np.sin(1.3 * time) + 0.4 * np.sin(3.1 * time)
    b = together * a if together else np.cos(2.2 * time)
    q = np.stack([a, b], 1)
    v = np.gradient(q, time, axis=0) + 1e-3 * rng.normal(size=q.shape)
    return Signals(time, q, v[:, ::-1] if swapped else v, np.zeros((1000, 0)))


@pytest.mark.parametrize("together", [-1.6, 1.0, 0.0])
def test_joints_that_move_together_keep_their_own_velocities(together):
    found = compare_velocities([moved(together)], JOINTS, [0, 1])
    assert found.partner.tolist() == [0, 1] and found.ratio == pytest.approx(1.0, abs=0.01)


def test_velocities_in_another_order_are_seen():
    assert compare_velocities([moved(0.0, swapped=True)], JOINTS, [0, 1]).partner.tolist() == [1, 0]
