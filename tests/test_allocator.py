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
    for megabytes in range(40, 60):
        torch.ones(megabytes * 2**18)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


for _ in range(4):
    faults()
print(faults())
"""


def faults_of_tensors(mode: str) -> int:
    done = subprocess.run([sys.executable, "-c", PROGRAM, mode], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_tensors_take_the_memory_of_those_before():
    assert faults_of_tensors("keep") < faults_of_tensors("give back") / 4
