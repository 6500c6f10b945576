"""KITTI's Velodyne scans (Geiger et al. 2013)."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.read_input import read_input

_RECORD_BYTES = 16  # x, y, z, reflectance


def read_scan(path: Path) -> NDArray[np.float32]:
    """Read a Velodyne scan.

    Args:
        path: the .bin file.

    Returns:
        float32 (N, 4): x, y, z [m] in the LiDAR's frame and reflectance 0..1.

    Raises:
        InputError: if the file cannot be read or is not whole records of four float32.
    """
    content = read_input(path)
    if len(content) % _RECORD_BYTES:
        raise InputError(
            f"{path} has {len(content)} bytes, expected a multiple of {_RECORD_BYTES} (x, y, z, "
            "reflectance as float32): the file is truncated or of another format"
        )
    points: NDArray[np.float32] = np.frombuffer(content, "<f4").reshape(-1, 4).astype(np.float32)
    return points
