"""Layouts in which one folder holds images with scans or depth maps, recognised by their names."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from runtime.base.errors import InputError
from runtime.base.natural_order import normal_form
from runtime.geometry.calibration import find_raw_calibration
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.folders import FolderSource, list_entries
from runtime.recordings.images import DEPTH_SUFFIXES, RGB_SUFFIXES, list_files, may_be_depth
from runtime.recordings.scan import SCAN_SUFFIXES

# How the names of the folders begin:
_IMAGES = ("image", "rgb", "color")
_MAPS = ("depth", "sparse_depth")
_SCANS = ("points", "velodyne", "lidar")  # may also hold depth maps, as in KITTI's depth selection
_JPEG = (".jpg", ".jpeg")
_FILES_OF_SCANS = tuple(suffix for suffix in SCAN_SUFFIXES if suffix not in DEPTH_SUFFIXES)
_IMAGES_OF_DEPTH = tuple(suffix for suffix in DEPTH_SUFFIXES if suffix not in SCAN_SUFFIXES)
_MAP = "depth"  # part of the name of a depth map that lies beside its image


class KittiObjectSource(FolderSource):
    """KITTI's object data (Geiger et al. 2012), whose layout View-of-Delft shares.

    The folder has `image_<camera>/ID.png`, `velodyne/ID.bin` and `calib/ID.txt`; everything else in
    it is ignored. Each frame has its own calibration. An image without a scan is a frame of the
    camera alone; a scan without an image is left out.

    Args:
        path: the folder, such as training.
        rig: without a calibration in it, calib/ is read; see `FolderSource`.
        camera: 2 is the left and 3 the right colour camera.
        **options: `points` and `point_columns` of `FolderSource`; without `points`, velodyne/ is
            read.

    Raises:
        InputError: if the images are missing, or if a calibration cannot be read.
    """

    accepted = "KITTI's object layout (holds image_2/, velodyne/ and calib/)"
    options = ("camera", "points", "point_columns")
    rig_options = ("calibration",)
    camera_alone = True

    def __init__(
        self, path: Path, rig: Rig = DEFAULT_RIG, *, camera: int = 2, **options: Any
    ) -> None:
        images = path / f"image_{camera}"
        if not os.path.isdir(images):
            raise InputError(
                f"{path} is not in KITTI's object layout: {images} is missing; give a folder like "
                "training, or another `camera=`"
            )
        scans, rig = path / "velodyne", replace(rig, calibration=rig.calibration or path / "calib")
        if options.get("points") is None:
            options["points"] = scans if os.path.isdir(scans) else None
        super().__init__(images, rig, camera=camera, **options)
        if self._depth is None:
            self._note("no velodyne folder, so only the camera is used; `points=` names the scans")

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return os.path.isdir(path / "image_2") and os.path.isdir(path / "calib")


class OneFolderSource(FolderSource):
    """A `FolderSource` that finds images, depth and calibration in one folder.

    The folder either holds two folders, one named image*, rgb* or color* and one named depth*,
    points*, velodyne* or lidar*; or it holds the files themselves: images with scans of the same
    stems, JPEGs with depth maps, or images with depth maps whose names contain "depth". The
    calibration of scans is the only calib* file or folder, or KITTI's two files, in the folder or
    its parent. The calibration of depth maps is a folder named intrinsics.

    Args:
        path: the folder.
        rig: without a calibration in it, the folder's own calibration is used.
        **options: see `FolderSource`; with `depth` or `points`, `path` is the folder of the images.

    Raises:
        InputError: if the folder holds several folders of one kind, and in the cases of
            `FolderSource`.
    """

    accepted = (
        "a folder that holds image*/ and depth*/, or image*/, points*/ and a calib* file, or "
        "images and depth maps or scans of the same names"
    )

    def __init__(self, path: Path, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        rgb, found, unread = path, None, []
        if options.get("depth") is None and options.get("points") is None:
            rgb, found, *unread = _find_folders(path) or (path, path)
        self._is_beside = found == path
        if found is not None:
            is_map = found.name.lower().startswith(_MAPS) or _holds(found, _IMAGES_OF_DEPTH)
            scans = _holds(found, _FILES_OF_SCANS) if self._is_beside else not is_map
            options["points" if scans else "depth"] = found
            if rig.calibration is None:
                rig = replace(rig, calibration=_find_calibration(path, of_scans=scans))
        super().__init__(rgb, rig, **options)
        for folder in unread:
            self._note(
                f"guessed: {folder.name}/ is not read; `rgb=`, `depth=` and `points=` name folders"
            )

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return _find_folders(path) is not None or _holds_both(path)

    def _list_images(self) -> Mapping[str, Any]:
        if not self._is_beside or self._has_scans:
            return super()._list_images()
        images = list_files(self._rgb, _JPEG if _holds(self._rgb, _JPEG) else RGB_SUFFIXES)
        return {stem: path for stem, path in images.items() if _MAP not in stem.lower()}

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        depths = super()._list_depths(folder)
        if not self._is_beside or self._has_scans or _holds(folder, _JPEG):
            return depths
        return {s: path for s, path in depths.items() if _MAP in s.lower() and may_be_depth(s)}


def _find_folders(path: Path) -> list[Path] | None:
    """Folders of [images, depth maps or scans, others that are not read]; None if one is missing.

    Raises InputError if the choice is ambiguous.
    """
    folders = sorted(entry for entry in list_entries(path) if os.path.isdir(entry))
    images, maps, scans = (
        [folder for folder in folders if folder.name.lower().startswith(kind)]
        for kind in (_IMAGES, _MAPS, _SCANS)
    )
    unlike = [folder for folder in images + maps + scans if not may_be_depth(folder.name)]
    maps, scans = ([each for each in found if each not in unlike] for found in (maps, scans))
    images = [folder for folder in images if folder not in unlike] or images
    others = maps or scans
    if len(images) + len(others) > 2 and images and others:
        names = ", ".join(folder.name for folder in images + others)
        raise InputError(
            f"{path} holds {names}: choose two folders by `rgb=` and `depth=` or `points=`"
        )
    unread = [*(scans if maps else []), *(each for each in unlike if each not in images)]
    return [images[0], others[0], *unread] if images and others else None


def _holds_both(path: Path) -> bool:
    """Whether images and their depth maps or scans lie in one folder."""
    names = [normal_form(entry.name).lower() for entry in list_entries(path)]

    def stems(suffixes: tuple[str, ...]) -> set[str]:
        return {name.removesuffix(end) for end in suffixes for name in names if name.endswith(end)}

    images, maps = stems(RGB_SUFFIXES), stems(DEPTH_SUFFIXES)
    named = {stem for stem in maps if _MAP in stem}
    return bool(
        images & stems(_FILES_OF_SCANS) or stems(_JPEG) & maps or (named and images - named)
    )


def _holds(folder: Path, suffixes: tuple[str, ...]) -> bool:
    return any(entry.name.lower().endswith(suffixes) for entry in list_entries(folder))


def _find_calibration(path: Path, *, of_scans: bool) -> Path | None:
    """The calibration in a folder or its parent; None if there is none, or more than one.

    For depth maps only the folder intrinsics/ of KITTI's depth selection is used.
    """
    if not of_scans:
        folder = path / "intrinsics"
        return folder if os.path.isdir(folder) else None
    if (raw := find_raw_calibration(path)) is not None:
        return raw
    files = [entry for entry in list_entries(path) if entry.name.startswith("calib")]
    return files[0] if len(files) == 1 else None
