"""A joint that the recordings of a diagnosis held still is held in its next motion, and tells nothing."""

import mujoco
import numpy as np
import pytest
from arms import NOISE, SERVO, explained, report_folder

from idapt_pl.diagnosis.answer.explanation import Measurement, Standing
from idapt_pl.effects.joints import JointDamping, JointFrictionloss
from idapt_pl.excitation.limits import ImpossibleMotion, limits_of
from idapt_pl.excitation.plan import MotionPlan, design_motion, prepare_search
from idapt_pl.excitation.rivals import read_left_open

AT = 0.7
JOINTED = SERVO.replace(
    'mass="0.4"/>',
    'mass="0.4"/><body name="tip" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-0.5 0.5" limited="true"/>'
    '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.1" mass="0.1" contype="0" conaffinity="0"/></body>',
).replace("</actuator>", '<motor name="pull" joint="elbow" ctrlrange="-1 1" ctrllimited="true"/></actuator>')
"""The rod with a second one on its end, whose joint is held, even outside its range."""

UNMEASURED = Measurement(NOISE.control_period, 5, True, (1e-3, 1e-9, 1e-2, 1e-9), (1e-3, 1e-9, 1e-2, 1e-9))
DAMPING = explained(Standing.FOUND, JointDamping("shoulder", 0.6), damping=(0.2, 0.2))
FRICTION = explained(Standing.EQUIVALENT, JointFrictionloss("shoulder", 0.12), frictionloss=(0.02, 0.1))
OF_ELBOW = explained(Standing.EQUIVALENT, JointDamping("elbow", 0.3), damping=(0.0, 0.1))


def left_open(folder, *explanations, held):
    report_folder(folder, *explanations, xml=JOINTED, measurement=UNMEASURED.to_dict(), held_joints=held)
    return read_left_open(folder / "nominal.xml", folder / "diagnosis")


def plan(**settings):
    limits = limits_of(mujoco.MjModel.from_xml_string(JOINTED), velocity={"*": (0, 3.0)})
    return MotionPlan(limits, **{"duration": 2.0, "seconds": 1.0} | settings)


def test_a_held_joint_stays_and_tells_nothing(tmp_path):
    open_ones = left_open(tmp_path, DAMPING, FRICTION, OF_ELBOW, held={"elbow": AT})
    design, _, forecaster = design_motion(open_ones, plan(), threads=1)
    assert forecaster.rest[1] == pytest.approx(AT, abs=1e-3)
    for seen in design.forecasts:
        assert seen.qpos[..., 1] == pytest.approx(AT, abs=1e-3) and np.ptp(seen.qpos[..., 0]) > 0.1
    friction, of_elbow, _ = design.separations
    assert 3 < friction < 100, "of the order of the shoulder's noise alone"
    assert of_elbow < 1, "how the held joint is damped does not show"
    assert np.ptp(design.commands[:, 1]) == 0 and np.ptp(design.commands[:, 0]) > 0.1, "it may be free on the machine"


def test_what_does_not_fit_a_held_joint_is_refused(tmp_path):
    open_ones = left_open(tmp_path, DAMPING, FRICTION, held={"elbow": AT})
    with pytest.raises(
        ImpossibleMotion, match=r"puts joint elbow at 0\.2; it is held where the recordings have it, at 0\.7"
    ):
        prepare_search(open_ones, plan(start=np.array([0.0, 0.2])), threads=1)
    prepare_search(open_ones, plan(start=np.array([0.0, 0.7001])), threads=1)


@pytest.mark.parametrize(
    ("held", "said"), [({"wrist": 0.0}, "it has no joint 'wrist'"), (["elbow"], "where joints were")]
)
def test_a_report_that_does_not_say_where_is_refused(tmp_path, held, said):
    with pytest.raises(ImpossibleMotion, match=said):
        left_open(tmp_path, DAMPING, held=held)
