"""The CUDA and cuDNN libraries that ONNX Runtime's CUDA provider loads, found by file name.

As `onnxruntime.preload_dlls` does it: in NVIDIA's pip packages first
(`site-packages/nvidia/*/lib`), then wherever the system's loader looks. Linux only.
"""

import ctypes
import re
import sys
from pathlib import Path

#: Assumed where ONNX Runtime does not report the CUDA version it was built for (CPU wheels).
NEWEST_CUDA_MAJOR = 13
DRIVER = "libcuda.so.1"

_CUDNN = "libcudnn.so.9"
_CURAND = "libcurand.so.10"  # of every CUDA so far
_CUFFT_MAJOR = {12: 11, 13: 12}


def cuda_major(cuda_version: str | None) -> int:
    """Return the major number of "13.0" or the like; NEWEST_CUDA_MAJOR where it is unknown."""
    found = re.match("[0-9]+", cuda_version or "")
    return int(found.group()) if found else NEWEST_CUDA_MAJOR


def library_names(major: int) -> tuple[str, ...]:
    """Return the files of CUDA `major` and cuDNN that are needed, and the driver's."""
    return (
        f"libcudart.so.{major}",
        f"libcublas.so.{major}",
        f"libcublasLt.so.{major}",
        f"libcufft.so.{_CUFFT_MAJOR.get(major, major - 1)}",
        _CURAND,
        f"libnvrtc.so.{major}",
        _CUDNN,
        DRIVER,
    )


def find_library(name: str) -> str | None:
    """Return the path of a library, or "on the loader's path"; None if it is not found.

    What the loader finds is also loaded: call it in a process that ends soon.
    """
    for folder in sys.path:
        for path in sorted(Path(folder).glob(f"nvidia/*/lib/{name}")):
            return str(path)
    try:
        ctypes.CDLL(name)
    except OSError:
        return None
    return "on the loader's path"
