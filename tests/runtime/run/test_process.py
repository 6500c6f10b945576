"""What ssdnet-run changes of its own process."""

import os
import subprocess
import sys

import pytest

FREED_AND_TAKEN = """
import resource, cv2, numpy as np
from runtime.run.process import dedicate_process
{call}
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
np.ones(24 << 20, np.uint8)
before = faults()
for _ in range(5):
    np.ones(24 << 20, np.uint8)
print(cv2.getNumThreads(), (faults() - before) / 5)
"""


def run(call):
    text = subprocess.run(
        [sys.executable, "-c", FREED_AND_TAKEN.format(call=call)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    threads, faults = text.split()
    return int(threads), float(faults)


def test_opencv_keeps_to_one_thread():
    threads, _ = run("dedicate_process()")
    assert threads == 1


@pytest.mark.skipif(
    not hasattr(os, "confstr") or "glibc" not in (os.confstr("CS_GNU_LIBC_VERSION") or ""),
    reason="the allocator is told on glibc alone",
)
def test_freed_memory_is_taken_again_without_page_faults():
    pages = (24 << 20) / os.sysconf("SC_PAGE_SIZE")
    _, faults = run("dedicate_process()")
    assert faults < pages / 50
