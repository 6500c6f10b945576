"""What ssdnet-run changes of its own process."""

import os
import subprocess
import sys

FREED_AND_TAKEN = """
import resource, cv2, numpy as np
from runtime.run.pipeline import dedicate_process
{call}
def answer_frame():
    [np.ones(24 << 20, np.uint8) for _ in range(4)]
answer_frame()
answer_frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    answer_frame()
faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(cv2.getNumThreads(), faults / 5)
"""
PAGES = 4 * (24 << 20) / os.sysconf("SC_PAGE_SIZE")


def run(call=""):
    """Threads of OpenCV, and page faults for each frame of four large pictures."""
    text = subprocess.run(
        [sys.executable, "-c", FREED_AND_TAKEN.format(call=call)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMPY_MADVISE_HUGEPAGE": "0"},
    ).stdout
    threads, faults = text.split()
    return int(threads), float(faults)


def test_opencv_keeps_to_one_thread_and_freed_memory_is_reused_without_page_faults():
    _, faults_before = run()
    threads, faults = run("dedicate_process()")
    assert threads == 1
    if "glibc" in (os.confstr("CS_GNU_LIBC_VERSION") or ""):  # the only allocator configured
        assert faults_before > PAGES / 4, "by default freed memory goes back to the kernel"
        assert faults < PAGES / 50
