"""What acts on several joints at once is undone where less does as well: a gain of all motors, a shared motor."""

import mujoco
import numpy as np
import pytest
from arm import ARM, record

from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.taking_apart import many_for_one_gain, own_for_shared_motor
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted

CART = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody>
<body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="1"/>
<geom type="box" size="0.1 0.1 0.1" mass="2" contype="0" conaffinity="0"/>
<body name="pole"><joint name="hinge" axis="0 1 0" damping="{hinge}"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.6" mass="{pole}" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><motor name="push" joint="slide" gear="{gear}"/></actuator></mujoco>"""
NOMINAL = CART.format(hinge=0.1, pole=1.0, gear=15)


def searched(xml, *found):
    """A search in recordings of a cart-pole, that has found these: label and value."""
    context, state = begin_search(mujoco.MjSpec.from_string(NOMINAL), record(xml, episodes=8), threads=1)
    of = {(c.label, c.size): c for c in context.candidates}
    accepted = [AcceptedEffect(k, of[label, 1], np.array([x])) for k, (label, x) in enumerate(found)]
    return context, refit_accepted(context, SearchState(state.fixed, tuple(accepted), state.windows))


def labels(state):
    return {c.label for c in state.candidates}


def test_a_heavier_pole_in_a_stiffer_bearing_is_no_weaker_motor_on_a_lighter_cart():
    context, state = searched(
        CART.format(hinge=0.15, pole=1.5, gear=15),
        ("actuator_gain(push)", 0.67), ("body_mass(cart)", 1.33), ("joint_damping(slide)", 0.67),
    )  # fmt: skip
    undone = many_for_one_gain(context, state)
    assert labels(undone) == {"body_mass(pole)", "joint_damping(hinge)"}
    values = {c.label: float(x[0]) for c, x in zip(undone.candidates, undone.estimates, strict=True)}
    assert values == pytest.approx({"body_mass(pole)": 1.5, "joint_damping(hinge)": 0.15}, rel=0.02)


def test_a_weaker_motor_stays_one():
    context, state = searched(
        CART.format(hinge=0.15, pole=1.0, gear=10), ("actuator_gain(push)", 0.67), ("joint_damping(hinge)", 0.15)
    )
    assert many_for_one_gain(context, state) is state


def test_without_a_gain_of_all_motors_there_is_nothing_to_undo():
    context, state = searched(
        CART.format(hinge=0.15, pole=1.5, gear=15), ("body_mass(pole)", 1.5), ("joint_damping(hinge)", 0.15)
    )
    assert many_for_one_gain(context, state) is state


SHARED_TENDON = """<tendon><fixed armature="0.02"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="1"/>
</fixed></tendon>"""


@pytest.mark.parametrize(
    ("hidden", "left"),
    [
        (ARM.replace('name="elbow"', 'name="elbow" armature="0.02"'), {"joint_armature(elbow)"}),
        (ARM.replace("<actuator>", SHARED_TENDON + "<actuator>"), {"shared_motor(shoulder elbow)"}),
    ],
)
def test_a_motor_that_one_joint_alone_turns_is_that_joints_own(hidden, left):
    context, state = begin_search(mujoco.MjSpec.from_string(ARM), record(hidden), threads=1)
    shared = next(c for c in context.candidates if c.label == "shared_motor(shoulder elbow)" and "ratio" in c.names)
    start = np.array([{"armature": 0.015, "ratio": 0.4}.get(name, 0.0) for name in shared.names])
    begun = SearchState(state.fixed, (AcceptedEffect(0, shared, start),), state.windows)
    assert labels(own_for_shared_motor(context, refit_accepted(context, begun))) == left
