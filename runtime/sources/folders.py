"""Images and depth maps or scans of the same names in two folders, or one of each."""

import os
from pathlib import Path
from typing import Any

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
from runtime.io.scan import SCAN_SUFFIXES, read_scan
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source, no_depth, pair_up

_SCAN_FOLDERS = ("points", "velodyne")


class FolderSource(Source):
    """Pairs of files with the same stem, in natural order ("9" before "10").

    Args:
        rgb: folder of PNG and JPEG files, or one such file; or, unless `depth` or `points` is
            given, a folder that holds an image*/ and a depth*/, points*/ or velodyne*/ folder.
        depth: folder of depth maps, or the one of one image, see `read_sparse_depth`.
        points: the same of scans, see `read_scan`, in place of depth; None: the camera alone.
        depth_scale: units of 16-bit depth maps per metre.
        point_columns: numbers per point of .bin scans; None: as `read_scan`.
        calibration: TOML or KITTI file, see `Calibration.from_file`. Scans need one; None: the only
            calib* file beside points*/ or velodyne*/.

    Raises:
        InputError: for a folder that holds several folders of a kind, for a file with a folder, for
            scans with depth or without a calibration, and if the calibration cannot be read.
    """

    accepted = (
        "a folder of images, one image, or a folder that holds image*/ and depth*/, or image*/, "
        "points*/ and a calib* file"
    )
    options = ("depth", "points", "depth_scale", "point_columns", "calibration")

    def __init__(
        self,
        rgb: Path,
        *,
        depth: Path | None = None,
        points: Path | None = None,
        depth_scale: float = KITTI_DEPTH_SCALE,
        point_columns: int | None = None,
        calibration: Path | None = None,
    ) -> None:
        if depth is None and points is None and (inner := _inner_folders(rgb)):
            if inner[1].name.startswith(_SCAN_FOLDERS):
                calibration = calibration or _inner_calibration(rgb)
                rgb, points = inner
            else:
                rgb, depth = inner
        if points is not None and depth is not None:
            raise InputError(f"give depth maps ({depth}) or scans ({points}), not both")
        if points is not None and calibration is None:
            raise InputError(f"the scans in {points} cannot be projected: give --calibration")
        self._depth_scale, self._point_columns = depth_scale, point_columns
        self._calibration, self._has_scans = calibration, points is not None
        self._what = "scan" if self._has_scans else "depth map"
        self._rgb, self._depth, self._is_one = rgb, depth or points, _is_image(rgb)
        if self._depth is not None and os.path.isfile(self._depth) != self._is_one:
            raise InputError(
                f"{rgb} and {self._depth} must be two folders, or an image and its {self._what}"
            )
        paths = (rgb,) if self._depth is None else (rgb, self._depth)
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
        images, suffixes = (
            list_files(self._rgb),
            SCAN_SUFFIXES if self._has_scans else DEPTH_SUFFIXES,
        )
        depths = None if self._depth is None else list_files(self._depth, suffixes)
        if depths is not None and not images.keys() & depths.keys():
            raise InputError(
                f"no name occurs in both folders: {self._rgb} has {_few(images)}, {self._depth} "
                f"has {_few(depths)}: the image and the {self._what} of a frame need the same file "
                "stem"
            )
        names = sorted(images.keys() | (depths or {}).keys(), key=natural_order)
        return pair_up(names, images, depths, limit=limit)

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where one of the two files is missing."""
        if self._depth is not None:
            require_pair(frame, self._what)
        rgb = read_rgb(frame.image)
        if self._depth is None:
            depth = no_depth(rgb)
        elif not self._has_scans:
            depth = read_sparse_depth(frame.depth, depth_scale=self._depth_scale)
        else:
            assert self.calibration is not None  # see __init__
            scan = read_scan(frame.depth, columns=self._point_columns)
            depth = self.calibration.project(scan, (rgb.shape[0], rgb.shape[1]))
        return Frame(rgb, depth, calibration=self.calibration)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        depth = None if self._depth is None else str(self._depth)
        calibration = None if self._calibration is None else str(self._calibration)
        scans = {"points": depth, "point_columns": self._point_columns, "calibration": calibration}
        maps = {"depth": depth, "depth_scale": self._depth_scale}
        return {"rgb": str(self._rgb), **(scans if self._has_scans else maps)}


def require_pair(frame: ListedFrame, what: str = "depth map") -> None:
    """Raise InputError if a frame lacks its image or its depth map (`what`)."""
    if frame.image is None:
        raise InputError(f"{frame.name} has a {what}, but no image")
    if frame.depth is None:
        raise InputError(f"{frame.name} has an image, but no {what}")


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in RGB_SUFFIXES and os.path.isfile(path)


def _entries(path: Path) -> list[Path]:
    """What a folder holds; nothing if it is none."""
    try:
        return list(path.iterdir())
    except OSError:
        return []


def _inner_folders(path: Path) -> tuple[Path, Path] | None:
    """The image*/ and the depth*/ folder, or else that of scans, that a folder holds; or None."""
    entries = _entries(path)
    images, maps, scans = (
        sorted(entry for entry in entries if entry.name.startswith(kind) and os.path.isdir(entry))
        for kind in ("image", "depth", _SCAN_FOLDERS)
    )
    others = maps or scans
    if not (images and others):
        return None
    if len(images) + len(others) > 2:
        names = ", ".join(folder.name for folder in images + others)
        raise InputError(
            f"{path} holds {names}: choose two folders by --rgb and --depth or --points"
        )
    return images[0], others[0]


def _inner_calibration(path: Path) -> Path | None:
    """The only calib* file that a folder holds; None of none or several."""
    files = [entry for entry in _entries(path) if entry.name.startswith("calib")]
    return files[0] if len(files) == 1 else None


def _few(names: dict[str, Path]) -> str:
    shown = ", ".join(sorted(names, key=natural_order)[:3])
    return f"{shown} …" if len(names) > 3 else shown
