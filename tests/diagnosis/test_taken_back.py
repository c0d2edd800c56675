"""An effect that sets a value anew where another one has set it already begins from that value."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arm import ARM, found, record

from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.screening import ScoreTest
from idapt_pl.diagnosis.state.search_state import AcceptedEffect
from idapt_pl.effects.joints import JointDamping

BARE = ARM.replace(' damping="0.05"', "").replace(' damping="0.02"', "")


def test_an_effect_that_is_declared_and_has_grown_is_found_with_its_new_value():
    data = record(ARM.replace('damping="0.02"', 'damping="0.15"'))
    declared = [JointDamping("elbow", 0.06)]
    diagnosis, effects = found(data, declared=declared, candidates=["joint_damping"], laws=False, threads=1)
    damping = effects["joint_damping", "elbow"]["parameters"]["damping"]
    assert diagnosis.result.verdict == "effects_found" and set(effects) == {("joint_damping", "elbow")}
    assert damping["estimate"] == pytest.approx(0.15, rel=0.02) and damping["nominal"] == 0.06


def test_one_joint_is_scored_from_the_value_that_all_were_given():
    data = record(BARE.replace('name="elbow" axis', 'name="elbow" damping="0.2" axis'))
    context, state = begin_search(mujoco.MjSpec.from_string(BARE), data, candidates=["joint_damping"], threads=1)
    of = {c.target: c for c in context.candidates}
    both = replace(state, accepted=(AcceptedEffect(0, of["*"], np.array([0.05])),))
    test = ScoreTest(context, both, both.windows.screen)
    begin, change = test.standing(of["shoulder"])
    assert begin.tolist() == [0.05] and np.abs(change).max() < 1e-9
    h = 0.05 * of["shoulder"].scale[0]
    ahead, there = (test.response_now(JointDamping("shoulder", x)) for x in (0.05 + h, 0.05))
    slope = test.derivative(of["shoulder"], begin, at_x=change)[:, 0]
    np.testing.assert_allclose(slope, (ahead - there) / 0.05)
    trial = test.score(of["shoulder"], (), 1)
    assert trial.rejection is None and trial.score > 100 and trial.x[0][0] < 0.01, "of the shoulder there is none"
    assert ScoreTest(context, state, state.windows.scout).standing(of["shoulder"])[1] is None
