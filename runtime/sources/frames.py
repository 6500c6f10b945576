"""Pair the files of two folders to frames, and read them."""

import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.image_header import picture_size

RGB_SUFFIXES = (".png", ".jpg", ".jpeg")
DEPTH_SUFFIXES = (".png",)
KITTI_DEPTH_SCALE = 256.0  # PNG units a metre; Virtual KITTI has 100
# Of a picture, before it is decoded: a header of a few bytes can ask for gigabytes.
MAX_PIXELS = 64_000_000
MAX_FILE_BYTES = 256_000_000


@dataclass(frozen=True)
class FrameFiles:
    """One name and the files found for it; a file that is missing is None."""

    name: str
    rgb: Path | None
    sparse_depth: Path | None

    @property
    def complete(self) -> bool:
        """Whether both files are there."""
        return self.rgb is not None and self.sparse_depth is not None


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture, uint8 (H, W, 3), and its sparse depth map, float32 (H, W) [m], 0 = no return.

    image_stamp_ns, depth_stamp_ns: when the sensors took them, by their own clock [ns]; None where
        that is not known, and where there is no depth
    calibration: of the camera, and of the LiDAR to it; None = not known
    Raises InputError for a calibration of pictures of another size.
    """

    rgb: NDArray[np.uint8]
    sparse_depth: NDArray[np.float32]
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        """Check what a cloud and the focal length would silently get wrong."""
        if self.calibration is not None:
            self.calibration.require_size(self.rgb.shape[:2])


def list_frames(
    rgb_dir: Path, depth_dir: Path, *, limit: int | None = None
) -> tuple[FrameFiles, ...]:
    """Pair the pictures of two folders by file stem, in natural order ("9" before "10").

    Names without a partner are listed too, with None for the missing file. With `limit` the list
    ends after that many complete frames. Files of other types and hidden files are left alone.

    Raises InputError if a folder is missing or has no pictures, if a stem occurs twice in a
    folder, or if no name occurs in both.
    """
    rgb = list_pictures(rgb_dir, RGB_SUFFIXES)
    depth = list_pictures(depth_dir, DEPTH_SUFFIXES)
    if not rgb.keys() & depth.keys():
        raise InputError(
            f"no name occurs in both folders: {rgb_dir} has {_few(rgb)}, {depth_dir} has "
            f"{_few(depth)}: the picture and the depth map of a frame need the same file stem"
        )
    frames: list[FrameFiles] = []
    complete = 0
    for name in sorted(rgb.keys() | depth.keys(), key=natural_order):
        if limit is not None and complete == limit:
            break
        frames.append(FrameFiles(name, rgb.get(name), depth.get(name)))
        complete += frames[-1].complete
    return tuple(frames)


def read_frame(files: FrameFiles, *, depth_scale: float) -> Frame:
    """Read both files of a frame.

    Raises InputError if one is missing or is not what it should be.
    """
    if files.rgb is None:
        raise InputError(f"{files.name} has a depth map, but no picture")
    if files.sparse_depth is None:
        raise InputError(f"{files.name} has a picture, but no depth map")
    return Frame(
        rgb=read_rgb(files.rgb),
        sparse_depth=read_sparse_depth(files.sparse_depth, depth_scale=depth_scale),
    )


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read a PNG or JPEG file as uint8 (H, W, 3), red first.

    A picture of one channel comes back with three equal ones. The pixels stay where the sensor
    has them, as in the depth map: an EXIF orientation is not followed.

    Raises InputError if the file cannot be read, is truncated or damaged, or has more than 8 bits
    a channel. A JPEG that is whole but damaged inside is decoded as far as it goes: its format has
    no checksum, PNG's has.
    """
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = decode(path, flags)
    if image.dtype != np.uint8:
        raise InputError(
            f"{path} must be a picture of 8 bits a channel, got {image.dtype.itemsize * 8} bits: "
            "is it a depth map, the folders swapped?"
        )
    return image


def read_sparse_depth(path: Path, *, depth_scale: float = KITTI_DEPTH_SCALE) -> NDArray[np.float32]:
    """Read a 16-bit PNG depth map as float32 (H, W) [m], 0 = no measurement.

    depth_scale: PNG units a metre, 256 for KITTI, 100 for Virtual KITTI.
    Raises InputError if the file cannot be read, is truncated or damaged, or is not one channel
    of 16 bits.
    """
    image = decode(path, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise InputError(
            f"{path} must be a depth map of one channel of 16 bits, got {channels} of "
            f"{image.dtype.itemsize * 8} bits: a picture made for looking at holds no metres"
        )
    depth: NDArray[np.float32] = np.divide(image, np.float32(depth_scale), dtype=np.float32)
    return depth


def decode(path: Path, flags: int) -> NDArray[Any]:
    """Decode a PNG or JPEG file with OpenCV's IMREAD_* `flags`.

    Raises InputError if the file cannot be read, is larger than MAX_FILE_BYTES, holds more than
    MAX_PIXELS, is of another format, or is truncated or damaged.
    """
    return decode_content(read_file(path), flags, name=str(path))


def decode_content(content: bytes, flags: int, *, name: str) -> NDArray[Any]:
    """Decode the content of a PNG or JPEG file as `decode` does; `name` is for the errors."""
    damaged = f"{name} is empty, truncated or damaged, or no PNG or JPEG ({len(content)} bytes)"
    size = picture_size(content)
    if size is None:
        raise InputError(damaged)
    require_pixels(size, name=name)
    try:
        image: NDArray[Any] | None = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(damaged)
    return image


def require_pixels(size: tuple[int, int], *, name: str) -> None:
    """Raise InputError for a picture of (height, width) that has more than MAX_PIXELS."""
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(
            f"{name} says that it has {size[0]} x {size[1]} pixels, expected at most "
            f"{MAX_PIXELS:,}: is it damaged?"
        )


def read_file(path: Path) -> bytes:
    """The content of a regular file of at most MAX_FILE_BYTES. Raises InputError."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # reading a pipe would wait for ever
            raise InputError(f"cannot read {path}: it is not a regular file")
        if status.st_size > MAX_FILE_BYTES:
            raise InputError(
                f"{path} has {status.st_size:,} bytes, expected a picture of at most "
                f"{MAX_FILE_BYTES:,}"
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from error


def list_pictures(folder: Path, suffixes: tuple[str, ...] = RGB_SUFFIXES) -> dict[str, Path]:
    """Stem -> path of the files of a folder that end in one of `suffixes`, hidden ones apart.

    Raises InputError if there is none, if the folder cannot be listed, or if a stem occurs twice.
    """
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot list the folder {folder} ({error.strerror})") from error
    pictures: dict[str, Path] = {}
    for path in paths:
        if path.suffix.lower() not in suffixes or path.name.startswith("."):
            continue
        if path.stem in pictures:
            raise InputError(
                f"{pictures[path.stem]} and {path} have the same stem: which one belongs to the "
                "frame cannot be known, remove one"
            )
        pictures[path.stem] = path
    if not pictures:
        raise InputError(
            f"the folder {folder} has no {' or '.join(suffixes)} files: give the folder that "
            "holds the frames themselves"
        )
    return pictures


def natural_order(name: str) -> tuple[list[str | int], str]:
    """Sort key: runs of digits count as numbers."""
    parts = re.split(r"([0-9]+)", name)  # text at even places, digits at odd ones
    return [int(part) if index % 2 else part for index, part in enumerate(parts)], name


def _few(names: dict[str, Path]) -> str:
    shown = ", ".join(sorted(names, key=natural_order)[:3])
    return f"{shown} …" if len(names) > 3 else shown
