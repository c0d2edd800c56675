"""Numbers too small to matter take no time."""

import subprocess
import sys

import torch

from idapt_pl.cores import FreeCores


def product_of_small_numbers() -> float:
    return float((torch.full((4,), 1e-38) * 1e-3).max())


def test_what_is_too_small_to_matter_is_zero_in_training():
    torch.set_flush_denormal(False)
    assert product_of_small_numbers() > 0
    FreeCores(1).look()
    assert product_of_small_numbers() == 0


def test_and_from_the_start():
    code = "import idapt_pl, torch; print(float((torch.full((4,), 1e-38) * 1e-3).max()))"
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, check=True)
    assert float(done.stdout) == 0
