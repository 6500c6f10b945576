"""Settings of a process that does nothing but run a stream."""

import contextlib
import ctypes

import cv2

# mallopt's names and numbers (malloc.h of glibc).
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BUFFER_BYTES = 32 << 20  # the most that glibc takes
_KEPT_FREE_BYTES = 256 << 20


def dedicate_process() -> None:
    """Give the cores to inference, and keep freed memory for the next frame.

    Changes OpenCV and the allocator of the whole process: for ssdnet-run and benchmarks, not for a
    program that embeds a Predictor.
    """
    cv2.setNumThreads(1)  # its threads would compete with those of an operator
    # Files that cannot be decoded are reported as skipped frames: OpenCV prints nothing.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    # glibc returns the memory of a freed picture, and the kernel clears every page of the next one.
    # Other C libraries have no mallopt.
    with contextlib.suppress(AttributeError, OSError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BUFFER_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_FREE_BYTES)
