"""How probable explanations are, in words and as a table."""

import re

from idapt_pl.diagnosis.answer.explanation import ExplainingEffect, Explanation, Standing
from idapt_pl.diagnosis.answer.result import ErrorTable
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.joints import JointDamping, JointFrictionloss
from idapt_pl.report.explanation_section import explanation_section, probability_sentences

GAIN = ExplainingEffect(ActuatorGain("hip", 0.9), {})
DAMPING, FRICTION = (ExplainingEffect(kind("knee", 0.1), {}) for kind in (JointDamping, JointFrictionloss))


def explained(standing, probability, *effects):
    return Explanation(standing, "", effects, 1.02, probability)


FOUND = explained(Standing.FOUND, 0.3, GAIN, DAMPING)
OTHER = explained(Standing.EQUIVALENT, 0.6, GAIN, FRICTION)
HOPELESS = explained(Standing.RUNNER_UP, 0.0, GAIN)
LEFT = ErrorTable(5, 0.1, (0,), (1,), 30.0, 1.24, 1.0, 1.5, 0.999, 0.0, {})


def text_of(html):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html))


def test_the_most_probable_comes_first_and_says_what_it_has_instead():
    text = text_of(explanation_section([FOUND, OTHER, HOPELESS], LEFT))
    first, second = text.index("in place of"), text.index("what was found")
    assert first < second and "60 %" in text and "30 %" in text
    assert "friction" in text[:first] and "damping" in text[first:second], "the gain is in both"
    assert text.index("gain") < text.index(" and ") and " or " not in text[: text.index("something else")]
    assert "With what was found, what is left is 1.24 times the measurement noise." in text
    assert "10 %" in text and "1 more are less probable than 0.5 %" in text


def test_what_was_found_is_listed_however_improbable():
    unlikely = explained(Standing.FOUND, 0.001, GAIN)
    text = text_of(explanation_section([unlikely], LEFT))
    assert "what was found" in text and "0.1 %" in text and "100 %" in text


def test_in_a_sentence():
    (sentence,) = probability_sentences([FOUND, OTHER, HOPELESS], LEFT)
    assert "30%" in sentence and "10%; what is left is 1.24 times the measurement noise." in sentence


def test_nothing_is_said_where_nothing_was_found():
    assert explanation_section([], LEFT) == "" and probability_sentences([], LEFT) == []
