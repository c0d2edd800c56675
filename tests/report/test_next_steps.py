"""What to do next is said of every effect, and linked from where it is named."""

import pytest

from idapt_pl.diagnosis.answer.result import EffectEstimate
from idapt_pl.effects.base import EFFECTS
from idapt_pl.report.next_steps import CONFIRM, OTHERWISE, anchor_of, linked_name, next_steps_section

OURS = [name for name, e in EFFECTS.items() if e.__module__.startswith("idapt_pl.")]


def estimate(effect, target="joint 1"):
    return EffectEstimate(effect, target, {})


@pytest.mark.parametrize("effect", OURS)
def test_every_effect_says_how_to_confirm_it_and_links_to_that(effect):
    found = estimate(effect)
    page = next_steps_section([found], "")
    assert len(CONFIRM[effect]) > 20 and CONFIRM[effect].endswith((".", "?")) and CONFIRM[effect] != OTHERWISE
    assert f'id="{anchor_of(found)}"' in page and f'href="#{anchor_of(found)}"' in str(linked_name(found))


def test_no_two_effects_are_confirmed_in_the_same_words_and_none_is_unheard_of():
    assert len(set(CONFIRM.values())) == len(CONFIRM) and set(CONFIRM) <= set(OURS)


def test_an_effect_of_somebody_else_has_a_general_word():
    assert OTHERWISE in next_steps_section([estimate("somebody_elses")], "")
