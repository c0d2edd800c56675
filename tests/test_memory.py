"""Freed memory is there for the next tensor, unless one asks for the allocator as it comes."""

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource, torch, idapt_pl
def faults():
    for _ in range(10):
        torch.ones(2**24)  # 64 MiB, more than glibc would ever keep by itself
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
faults()  # where things lie settles
first = faults()
print(faults() - first)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_large_tensors_are_made_of_what_others_have_left():
    def page_faults(keep: str) -> int:
        environment = os.environ | {"IDAPT_KEEP_MEMORY": keep}
        command = [sys.executable, "-c", FAULTS]
        return int(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)

    assert page_faults("1") < 0.1 * page_faults("0")
