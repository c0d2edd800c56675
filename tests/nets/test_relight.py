"""What is done to images on their way to the nets."""

import numpy as np
import torch

from idapt_pl.nets.images import relight


def test_another_light_is_one_for_a_whole_stack_and_keeps_what_is_darker_darker():
    torch.manual_seed(0)
    frame = torch.rand(40, 3, 6, 6) * 1.6 - 0.9
    stacks = torch.cat([frame, frame], 1)
    lit = relight(stacks, 0.7)
    torch.testing.assert_close(lit[:, :3], lit[:, 3:])
    assert lit.min() >= -1 and lit.max() <= 1
    as_they_were = (lit == stacks).flatten(1).all(1)
    assert 0 < as_they_were.sum() < 20
    before, after = frame[0].flatten(1), lit[0, :3].flatten(1)
    for channel in range(3):  # in each colour, what was darker is not brighter now
        order = before[channel].argsort()
        assert (after[channel][order].diff() >= -1e-5).all()
    assert relight(stacks, 0.0) is stacks


def test_light_varies_as_much_as_it_is_told():
    torch.manual_seed(1)
    grey = torch.zeros(4000, 3, 1, 1)  # 0.5 of full brightness
    seen = (relight(grey, 0.4) + 1) / 2
    brightest, darkest = 0.5 ** np.exp(-0.4) * np.exp(0.4 * 1.3), 0.5 ** np.exp(0.6) * np.exp(-0.4 * 1.3)
    assert darkest < seen.min() < 1.3 * darkest and 0.9 * min(1, brightest) < seen.max() <= min(1, brightest) + 1e-6
