"""What to record next, where two explanations do as well."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from idapt_pl.diagnosis.answer import advice


@pytest.mark.parametrize(
    ("apart", "words"),
    [(0.5, "record more like swing at 0.20 s"), (0.02, "no recording like these will do: nowhere.*0.02 sigma.*excite")],
)
def test_more_of_a_recording_is_asked_for_only_where_it_tells_them_apart(monkeypatch, apart, words):
    a, b = np.zeros((3, 4)), np.zeros((3, 4))
    b[1] = apart
    monkeypatch.setattr(advice, "predictions_apart", lambda context, state, effect: (a, b))
    swing = SimpleNamespace(name="swing", time=0.1 * np.arange(9), qvel=np.ones((9, 1)), actions=np.ones((9, 1)))
    windows = SimpleNamespace(episode=np.zeros(3, int), start=np.array([0, 2, 4]), offsets=np.array([1, 2]))
    state = SimpleNamespace(windows=SimpleNamespace(fit=SimpleNamespace(windows=windows)))
    context = SimpleNamespace(sim=SimpleNamespace(data=[swing], channels=["hinge"]))
    assert re.search(words, advice.separating_recording(context, state, effect=None))
