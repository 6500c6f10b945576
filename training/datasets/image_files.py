"""Image files as arrays, with an error that names the file."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit colour image: uint8 (H, W, 3), RGB. Raises DatasetError."""
    image = _read(path, cv2.IMREAD_COLOR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)


def read_gray(path: Path, dtype: type[np.uint8] | type[np.uint16]) -> NDArray[Any]:
    """Read a one-channel PNG of exactly ``dtype``: (H, W). Raises DatasetError."""
    image = _read(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != dtype:
        raise DatasetError(
            f"{path}: expected one channel of {np.dtype(dtype).name}, got shape {image.shape} of "
            f"{image.dtype}. Restore the data set's original file."
        )
    return image


def require_size(path: Path, size: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Raise a DatasetError if (height, width) is not what the frame's image has."""
    if size[:2] != expected:
        raise DatasetError(
            f"{path}: its size {size[0]}x{size[1]} differs from the image's "
            f"{expected[0]}x{expected[1]} (height x width). Restore the data set's original file."
        )


def require_folder(path: Path, purpose: str) -> Path:
    """Return ``path`` or raise a DatasetError that says what should be in it."""
    if not path.is_dir():
        raise DatasetError(f"{path}: no such folder; expected {purpose}.")
    return path


def _read(path: Path, flags: int) -> NDArray[Any]:
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}.") from error
    image = cv2.imdecode(data, flags) if data.size else None
    if image is None:
        raise DatasetError(f"{path}: not a readable image; the file is truncated or damaged.")
    return image
