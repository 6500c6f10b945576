"""Pair the files of two folders to frames, and read them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import (
    DEPTH_SUFFIXES,
    RGB_SUFFIXES,
    list_pictures,
    natural_order,
    read_rgb,
    read_sparse_depth,
)


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


def _few(names: dict[str, Path]) -> str:
    shown = ", ".join(sorted(names, key=natural_order)[:3])
    return f"{shown} …" if len(names) > 3 else shown
