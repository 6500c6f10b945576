"""Files of data sets as arrays. Errors of the engine's readers become a DatasetError."""

import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from runtime.base.errors import DatasetError, InputError
from runtime.files.read_input import read_input
from runtime.geometry.returns import is_measured
from runtime.recordings import images


@contextmanager
def dataset_errors() -> Iterator[None]:
    """Turn an InputError of the block or function into a DatasetError."""
    try:
        yield
    except InputError as error:
        raise DatasetError(str(error)) from error


# A reader of the engine with such errors.
read_rgb = dataset_errors()(images.read_rgb)


@dataset_errors()
def read_gray(
    path: Path, dtype: type[np.uint8] | type[np.uint16], size: tuple[int, int]
) -> NDArray[Any]:
    """Read the numbers that a PNG of this (height, width) stores: gray, or indices of a palette.

    A picture decoder would stretch numbers of 1, 2 and 4 bits to 0..255 and replace indices by
    colours. For uint8, a file with 16 bits may hold numbers up to 255. Raises DatasetError for
    another kind of file, another size, several channels, or a palette of grays that are not its
    indices.
    """
    content = read_input(path)
    # From the header IHDR: the bits of a number, and the type, where 0 = gray and 3 = palette.
    bits, kind = content[24:26] if content[:4] == b"\x89PNG" and len(content) > 25 else (0, -1)
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    image = images.decode(content, flags, name=str(path))  # finds damage
    if kind == 3:
        image = _indices(content, path)
    elif 0 < bits < 8:
        image //= 255 // (2**bits - 1)
    if dtype is np.uint8 and image.dtype == np.uint16 and image.max() < 256:
        image = image.astype(np.uint8)
    if kind not in (0, 3) or image.dtype != dtype:
        raise DatasetError(
            f"{path}: expected one channel of {np.dtype(dtype).name}, or a palette, in a PNG: "
            "convert it without colours, transparency or JPEG compression, or say which class has "
            "which colour (label_colors; in a list of classes: road 128 64 128)"
        )
    require_size(path, image.shape, size)
    return image


def _indices(content: bytes, path: Path) -> NDArray[np.uint8]:
    """Return the indices in a PNG with a palette."""
    picture = Image.open(io.BytesIO(content))
    indices = np.array(picture, np.uint8)
    colors = np.array(picture.getpalette("RGB")).reshape(-1, 3)
    if (colors == colors[:, :1]).all() and (colors[:, 0] != np.arange(len(colors))).any():
        raise DatasetError(
            f"{path}: its palette is of grays that are not its indices, so that a pixel has two "
            "numbers: convert it to 8-bit gray"
        )
    return indices


@dataset_errors()
def read_depth(path: Path, size: tuple[int, int], *, depth_scale: float) -> NDArray[np.float32]:
    """Read a 16-bit PNG with `depth_scale` units per metre: float32 (height, width) [m], 0 = none.

    65535 is no measurement, too. Raises DatasetError.
    """
    depth = measured(images.read_sparse_depth(path, depth_scale=depth_scale))
    require_size(path, depth.shape, size)
    return depth


def measured(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a depth map with 0 where nothing was measured, see `is_measured`."""
    return np.where(is_measured(depth), depth, np.float32(0))


def require_size(path: Path, size: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Raise a DatasetError unless the file has the expected (height, width)."""
    if size[:2] != expected:
        raise DatasetError(
            f"{path}: its size {size[0]}x{size[1]} differs from the frame's "
            f"{expected[0]}x{expected[1]} (height x width): give files of the size of the image"
        )


def require_folder(path: Path, purpose: str) -> Path:
    """Return `path`; raise a DatasetError if it is not a folder."""
    if not os.path.isdir(path):
        beside = [item.name for item in path.parent.glob("[!.]*/")]
        raise DatasetError(
            f"{path}: no such folder, expected {purpose}: correct the path (folders there: "
            f"{list_names(beside)})"
        )
    return path


def require_files(
    folder: Path, purpose: str, names: Iterable[str], name: str = "{}.png"
) -> dict[str, Path]:
    """Return the file of each frame in a folder, `name` with the frame's name in it.

    Raises a DatasetError if the folder or one of the files is missing.
    """
    there = {file.name for file in require_folder(folder, purpose).iterdir()}
    files = {frame: folder / name.format(frame) for frame in names}
    missing = [file for file in files.values() if file.name not in there]
    if missing:
        raise DatasetError(f"{missing[0]}: missing ({len(missing)} of {len(files)} frames lack it)")
    return files


def find_orientations(paths: Sequence[Path]) -> dict[Path, int]:
    """Return the EXIF orientation, 2 to 8, of each photo that viewers turn or mirror."""
    found = {}
    for path in paths:
        with suppress(OSError, SyntaxError, ValueError), Image.open(path) as picture:
            orientation = picture.getexif().get(ExifTags.Base.Orientation, 1)
            if orientation in range(2, 9):
                found[path] = orientation
    return found


def list_names(names: Sequence[str]) -> str:
    """Return the first names in order, for a message."""
    shown = sorted(names)[:10]
    more = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    return f"{', '.join(shown) or 'none'}{more}"
