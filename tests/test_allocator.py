import platform
import subprocess
import sys

import pytest

PROGRAM = """
import resource
import sys

import torch

from nmbg.allocator import keep_freed_memory

if sys.argv[1] == "keep":
    keep_freed_memory()


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(2**24)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


print(min(faults() for _ in range(5)))  # a block beside one that is in use may not fit again at once
"""


def fewest_faults_of_a_tensor(mode: str) -> int:
    done = subprocess.run([sys.executable, "-c", PROGRAM, mode], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_a_tensor_takes_the_memory_of_the_one_before():
    assert fewest_faults_of_a_tensor("keep") < 8 < fewest_faults_of_a_tensor("give back")
