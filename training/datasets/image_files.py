"""Image files as arrays, with an error that names the file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError, InputError
from runtime.io import images


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit colour image: uint8 (H, W, 3), RGB. Raises DatasetError."""
    with _as_dataset_error():
        return images.read_rgb(path)


def read_gray(path: Path, dtype: type[np.uint8] | type[np.uint16]) -> NDArray[Any]:
    """Read a one-channel PNG of exactly ``dtype``: (H, W). Raises DatasetError."""
    with _as_dataset_error():
        image = images.decode(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != dtype:
        raise DatasetError(
            f"{path}: expected one channel of {np.dtype(dtype).name}, got shape {image.shape} of "
            f"{image.dtype}. Restore the data set's original file."
        )
    return image


@contextmanager
def _as_dataset_error() -> Iterator[None]:
    """Turn what the engine's reader says of a file into an error of the data set."""
    try:
        yield
    except InputError as error:
        raise DatasetError(f"{error}. Restore the data set's original file.") from error


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
