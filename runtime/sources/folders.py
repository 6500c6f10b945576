"""Images and depth maps of the same names in two folders, or one of each."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import (
    DEPTH_SUFFIXES,
    KITTI_DEPTH_SCALE,
    RGB_SUFFIXES,
    list_files,
    natural_order,
    read_rgb,
    read_sparse_depth,
)
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source, no_depth, pair_up


class FolderSource(Source):
    """Pairs of files with the same stem, in natural order ("9" before "10").

    Args:
        rgb: folder of PNG and JPEG files, or one such file; or a folder that holds an image*/ and a
            depth*/ folder, unless `depth` is given.
        depth: folder of depth maps, or the one of one image, see `read_sparse_depth`; None: the
            camera alone.
        depth_scale: units of 16-bit depth maps per metre.
        calibration: TOML or KITTI file, see `Calibration.from_file`.

    Raises:
        InputError: for a folder that holds several image*/ or depth*/ folders, for a file with a
            folder, and if the calibration cannot be read.
    """

    accepted = "a folder of images, one image, or a folder that holds image*/ and depth*/"
    options = ("depth", "depth_scale", "calibration")

    def __init__(
        self,
        rgb: Path,
        *,
        depth: Path | None = None,
        depth_scale: float = KITTI_DEPTH_SCALE,
        calibration: Path | None = None,
    ) -> None:
        if depth is None:
            rgb, depth = _inner_folders(rgb) or (rgb, None)
        self._rgb, self._depth, self._depth_scale = rgb, depth, depth_scale
        self._is_one = _is_image(rgb)
        if depth is not None and os.path.isfile(depth) != self._is_one:
            raise InputError(
                f"{rgb} and {depth} must be two folders, or an image and its depth map"
            )
        paths = (rgb,) if depth is None else (rgb, depth)
        self.folders = tuple(path.parent for path in paths) if self._is_one else paths
        if calibration is not None:
            self.calibration = Calibration.from_file(calibration)

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return _is_image(path) or any(map(_is_image, _entries(path))) or bool(_inner_folders(path))

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A name without a partner is listed too.

        Raises:
            InputError: if a folder is missing or has no images, if a stem occurs twice in a folder,
                or if no stem occurs in both.
        """
        if self._is_one:
            return (ListedFrame(0, self._rgb.stem, self._rgb, self._depth),)
        images = list_files(self._rgb)
        maps = None if self._depth is None else list_files(self._depth, DEPTH_SUFFIXES)
        if maps is not None and not images.keys() & maps.keys():
            raise InputError(
                f"no name occurs in both folders: {self._rgb} has {_few(images)}, {self._depth} "
                f"has {_few(maps)}: the image and the depth map of a frame need the same file "
                "stem"
            )
        names = sorted(images.keys() | (maps or {}).keys(), key=natural_order)
        return pair_up(names, images, maps, limit=limit)

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where one of the two files is missing."""
        if self._depth is None:
            rgb = read_rgb(frame.image)
            return Frame(rgb, no_depth(rgb), calibration=self.calibration)
        read_depth = partial(read_sparse_depth, depth_scale=self._depth_scale)
        return read_pair(frame, read_depth, self.calibration)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        depth = None if self._depth is None else str(self._depth)
        return {"rgb": str(self._rgb), "depth": depth, "depth_scale": self._depth_scale}


def read_pair(
    frame: ListedFrame,
    read_depth: Callable[[Path], NDArray[np.float32]],
    calibration: Calibration | None,
) -> Frame:
    """Read an image and its depth map. Raises InputError if one is missing or damaged."""
    if frame.image is None:
        raise InputError(f"{frame.name} has a depth map, but no image")
    if frame.depth is None:
        raise InputError(f"{frame.name} has an image, but no depth map")
    return Frame(read_rgb(frame.image), read_depth(frame.depth), calibration=calibration)


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in RGB_SUFFIXES and os.path.isfile(path)


def _entries(path: Path) -> list[Path]:
    """What a folder holds; nothing if it is none."""
    try:
        return list(path.iterdir())
    except OSError:
        return []


def _inner_folders(path: Path) -> tuple[Path, Path] | None:
    """The image*/ and the depth*/ folder that a folder holds; None without one of each."""
    entries = _entries(path)
    images, depths = (
        sorted(entry for entry in entries if entry.name.startswith(kind) and os.path.isdir(entry))
        for kind in ("image", "depth")
    )
    if not (images and depths):
        return None
    if len(images) + len(depths) > 2:
        names = ", ".join(folder.name for folder in images + depths)
        raise InputError(
            f"{path} holds {names}: choose an image and a depth folder by --rgb, --depth"
        )
    return images[0], depths[0]


def _few(names: dict[str, Path]) -> str:
    shown = ", ".join(sorted(names, key=natural_order)[:3])
    return f"{shown} …" if len(names) > 3 else shown
