"""A stage computes with the cores that nobody else uses, and gets the same numbers."""

import subprocess
import sys
import time

import pytest
import torch

from idapt_pl import cores
from idapt_pl.cores import CoreUse, FreeCores, at_once, free_threads

BUSY = "import time; end = time.time() + {}\nwhile time.time() < end: pass"


@pytest.fixture(autouse=True)
def threads_as_before():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(("others", "expected"), [(0.0, 4), (0.4, 4), (0.6, 3), (1.0, 3), (2.9, 1), (9.0, 1)])
def test_threads_are_the_cores_that_are_left_and_never_none(monkeypatch, others, expected):
    monkeypatch.setattr(cores, "_FIRST_THREADS", 4)
    assert free_threads(others) == expected


def test_a_busy_process_is_seen_and_ones_own_work_and_helpers_are_not():
    use = CoreUse()
    time.sleep(0.2)
    elsewhere = use.others()  # tests may run beside each other
    other = subprocess.Popen([sys.executable, "-c", BUSY.format(3)], start_new_session=True)
    helper = subprocess.Popen([sys.executable, "-c", BUSY.format(3)], process_group=0)  # as those that render
    try:
        time.sleep(0.3)
        use.others()
        before = use._own()
        time.sleep(0.7)
        assert use._own() - before > 0.05, "helpers are one's own"
        assert use.others() > min(0.2, elsewhere)
    finally:
        other.kill(), helper.kill()
        other.wait(), helper.wait()


class TwoWays:
    two_ways = False


@pytest.mark.parametrize(("threads", "two", "each"), [(1, False, 1), (2, True, 1), (4, True, 2)])
def test_a_module_of_two_ways_shares_its_threads_between_them(threads, two, each):
    module = TwoWays()
    FreeCores().share(module, threads)
    assert (module.two_ways, torch.get_num_threads()) == (two, each)


def test_what_begins_takes_the_cores_that_are_free_now(monkeypatch):
    monkeypatch.setattr(cores, "_FIRST_THREADS", 4)
    monkeypatch.setattr(CoreUse, "others", lambda self: 2.0)
    FreeCores().look()
    assert torch.get_num_threads() == 2
    FreeCores(3).look()
    assert torch.get_num_threads() == 3


def test_two_things_at_once_are_what_they_are_one_after_the_other():
    x = torch.randn(64, 64, requires_grad=True)

    def first():
        (x @ x).sum().backward()
        return "first"

    def second():
        (x * x).sum().backward()
        return "second"

    first(), second()
    expected, x.grad = x.grad, None
    for _ in range(20):
        assert at_once(first, second) == ("first", "second")
        assert torch.equal(x.grad, expected)
        x.grad = None


def test_the_second_thread_computes_in_the_precision_of_the_first():
    x = torch.randn(8, 8)
    with torch.autocast("cpu", torch.bfloat16):
        kinds = at_once(lambda: (x @ x).dtype, lambda: (x @ x).dtype)
    assert kinds == (torch.bfloat16, torch.bfloat16)
    assert at_once(lambda: (x @ x).dtype, lambda: (x @ x).dtype) == (torch.float32, torch.float32)


def test_an_error_of_either_reaches_the_caller():
    def fails():
        raise ValueError("no")

    for pair in ((fails, int), (int, fails)):
        with pytest.raises(ValueError, match="no"):
            at_once(*pair)
