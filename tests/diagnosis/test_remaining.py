"""Explanations that are the same as what was found, by construction."""

from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.answer.explanation import ExplainingEffect, Explanation, Standing
from idapt_pl.diagnosis.answer.probabilities import probabilities
from idapt_pl.diagnosis.answer.remaining import JudgedExplanation, with_probabilities, with_twin
from idapt_pl.diagnosis.answer.summary import inseparable
from idapt_pl.effects.actuators import MotorResistance
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.signals import ActuatorDelay
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.force_windows import judged_by_forces

DAMPING = ExplainingEffect(JointDamping("hip", 0.3), {"damping": (0.1, 0.05)})


def test_late_measurements_take_the_place_of_late_commands_with_the_same_number():
    delay = Candidate(ActuatorDelay, "*", ("delay",), (0.0,), (0.02,))
    found = Explanation(
        Standing.FOUND, "", (ExplainingEffect(ActuatorDelay("*", 0.016), {"delay": (0.0, 0.02)}), DAMPING), 0.8, 0.5
    )
    (twin,) = inseparable(None, SimpleNamespace(candidate=delay, x=np.array([0.016])))
    same = with_twin(JudgedExplanation(found, np.ones(3)), 1, twin).value
    assert [(e.effect.name, e.free) for e in same.effects] == [
        ("sensor_delay", {"delay": (0.0, 0.02)}), ("joint_damping", DAMPING.free)
    ]  # fmt: skip
    assert same.standing is Standing.EQUIVALENT and same.loss == found.loss


def test_a_gain_takes_the_place_of_a_resistance_with_one_over_its_number():
    resistance = Candidate(MotorResistance, "knee", ("resistance",), (1.0,), (0.2,))
    found = Explanation(
        Standing.FOUND,
        "",
        (DAMPING, ExplainingEffect(MotorResistance("knee", 1.6), {"resistance": (1.0, 0.2)})),
        0.8,
        0.5,
    )
    (twin,) = inseparable(None, SimpleNamespace(candidate=resistance, x=np.array([1.6])))
    same = with_twin(JudgedExplanation(found, np.ones(3)), 0, twin).value
    assert same.effects[0] is DAMPING and same.effects[1].effect.gain == 0.625
    nominal, scale = same.effects[1].free["gain"]
    assert (nominal, scale) == pytest.approx((1.0, 0.2 * 0.625**2))


def test_evidence_of_forces_counts_once_for_each_degree_of_freedom():
    """Forecasts are compared in positions and velocities, twice as many."""
    split = judged_by_forces(Windows(np.zeros(2, int), np.array([0, 5]), np.array([5])), np.ones(3))
    losses = [np.ones(len(split.windows)), np.full(len(split.windows), 1.2)]
    told = [JudgedExplanation(Explanation(Standing.FOUND, "", (DAMPING,), 1.0, 0.0), x) for x in losses]
    context = SimpleNamespace(seed=0, sim=SimpleNamespace(compared=np.ones(6, bool)))
    state = SimpleNamespace(windows=SimpleNamespace(held_out=split))
    p = [e.probability for e in with_probabilities(context, state, told)]
    assert p == pytest.approx(probabilities(losses, 3, [1, 1], [0, 0]), abs=1e-4)
    assert p != pytest.approx(probabilities(losses, 6, [1, 1], [0, 0]), abs=0.01)
