"""Numbers too small to matter take no time."""

import torch

import idapt_pl  # noqa: F401


def test_what_is_too_small_to_matter_is_zero():
    tiny = torch.full((4,), 1e-38)
    assert torch.equal(tiny * 1e-3, torch.zeros(4))
