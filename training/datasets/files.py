"""Files of data sets as arrays; what the engine's readers find wrong is a DatasetError."""

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError, InputError
from runtime.io import images, scan
from runtime.read_input import read_input


@contextmanager
def dataset_errors() -> Iterator[None]:
    """Raise an InputError of the block or function as a DatasetError."""
    try:
        yield
    except InputError as error:
        raise DatasetError(str(error)) from error


_SUFFIXES = {".png", ".jpg"}
_PNG, _PALETTE = b"\x89PNG\r\n\x1a\n", 3  # how a file starts; a color type
#: The engine's readers, see there.
read_rgb = dataset_errors()(images.read_rgb)
read_points = dataset_errors()(scan.read_scan)


@dataset_errors()
def read_gray(
    path: Path, dtype: type[np.uint8] | type[np.uint16], size: tuple[int, int]
) -> NDArray[Any]:
    """Read the numbers that a PNG of (height, width) stores: grey, or the indices of a palette.

    For uint8 they have 1 to 16 bits. Raises DatasetError.
    """
    content = read_input(path)
    if not content.startswith(_PNG):
        raise DatasetError(f"{path}: expected a PNG; other formats change the numbers.")
    bits, color = content[24:26].ljust(2)
    if color == _PALETTE:
        content = _indices(content, path)
    image = images.decode(content, cv2.IMREAD_UNCHANGED, name=str(path))
    if bits < 8 and image.ndim == 2:  # the decoder stretches them to 0..255
        image = image // (255 // (2**bits - 1))
    if dtype is np.uint8 and image.dtype == np.uint16 and image.max() < 256:
        image = image.astype(np.uint8)
    if image.ndim != 2 or image.dtype != dtype:
        raise DatasetError(
            f"{path}: expected one channel of {np.dtype(dtype).name}, got shape {image.shape} of "
            f"{image.dtype}. Restore the data set's original file, or convert your own to one "
            "number a pixel."
        )
    require_size(path, image.shape, size)
    return image


def _indices(content: bytes, path: Path) -> bytes:
    """A PNG with a palette as one in grey, of its indices. Raises DatasetError."""
    kept, position = [_PNG], len(_PNG)
    while position + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        chunk = content[position : position + 12 + length]
        position += len(chunk)
        if kind == b"IHDR":
            grey = chunk[4:17] + b"\0" + chunk[18:21]  # another color type
            chunk = chunk[:4] + grey + struct.pack(">I", zlib.crc32(grey))
        if kind == b"PLTE":
            colors = np.frombuffer(chunk[8:-4], np.uint8, length // 3 * 3).reshape(-1, 3)
            is_grey = (colors == colors[:, :1]).all()
            if is_grey and (colors[:, 0] != np.arange(len(colors))).any():
                raise DatasetError(
                    f"{path}: its palette is of greys that are not its indices, so that a pixel "
                    "has two numbers. Convert it to 8-bit grey."
                )
        if kind in (b"IHDR", b"IDAT", b"IEND"):
            kept.append(chunk)
    return b"".join(kept)


@dataset_errors()
def read_depth(path: Path, size: tuple[int, int], *, depth_scale: float) -> NDArray[np.float32]:
    """Read a 16-bit PNG of `depth_scale` units a metre: float32 (height, width) [m], 0 = none.

    65535 is none, too. Raises DatasetError.
    """
    depth = images.read_sparse_depth(path, depth_scale=depth_scale)
    depth = np.where(np.isfinite(depth), depth, np.float32(0))
    require_size(path, depth.shape, size)
    return depth


def require_size(path: Path, size: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Raise a DatasetError unless the file's (height, width) is the expected one."""
    if size[:2] != expected:
        raise DatasetError(
            f"{path}: its size {size[0]}x{size[1]} differs from the frame's "
            f"{expected[0]}x{expected[1]} (height x width). Restore the data set's original file."
        )


def require_folder(path: Path, purpose: str, *, files: Sequence[str] = ()) -> Path:
    """Return `path`; raise a DatasetError if it is no folder or lacks a file of these names."""
    if not os.path.isdir(path):
        beside = [item.name for item in path.parent.glob("[!.]*/")]
        raise DatasetError(
            f"{path}: no such folder; expected {purpose}. Folders there: {list_names(beside)}."
        )
    there = {file.name for file in path.iterdir()} if files else set()
    missing = [name for name in files if name not in there]
    if missing:
        raise DatasetError(
            f"{path / missing[0]}: missing ({len(missing)} of {len(files)} frames lack it)."
        )
    return path


def list_images(folder: Path, purpose: str) -> list[Path]:
    """Return the .png and .jpg images of a folder in order; DatasetError without any."""
    images = sorted(
        path for path in require_folder(folder, purpose).iterdir() if path.suffix in _SUFFIXES
    )
    if not images:
        raise DatasetError(f"{folder}: no .png or .jpg images in it; expected {purpose}.")
    return images


def list_names(names: Sequence[str]) -> str:
    """Return the first names in order, for a message."""
    shown = sorted(names)[:10]
    more = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    return f"{', '.join(shown) or 'none'}{more}"
