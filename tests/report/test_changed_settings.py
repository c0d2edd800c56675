"""Intervals of a model's settings: of which effect each is."""

from types import SimpleNamespace

from idapt_pl.diagnosis.answer.result import EffectEstimate, ParameterEstimate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.report.changed_settings import effects_at_ends


def test_two_ends_of_one_joint_have_intervals_of_their_own():
    def found(end, at, low, high):
        return EffectEstimate(
            "joint_range", "hip", {end: ParameterEstimate(None, at, (low, high), "rad")}, equivalent=()
        )

    lower, upper = JointRange("hip", lower=-0.5), JointRange("hip", upper=0.7)
    result = SimpleNamespace(effects=[found("lower", -0.5, -0.6, -0.4), found("upper", 0.7, 0.6, 0.8)])
    diagnosis = SimpleNamespace(result=result, effects=(lower, upper), declared=())
    ends = list(effects_at_ends(diagnosis))
    assert [e[0] for e in ends[:2]] == [JointRange("hip", lower=-0.6), JointRange("hip", lower=-0.4)]
    assert [e[1] for e in ends[2:]] == [JointRange("hip", upper=0.6), JointRange("hip", upper=0.8)]
    assert all(e[1] == upper for e in ends[:2]) and all(e[0] == lower for e in ends[2:])
