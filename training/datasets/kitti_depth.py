"""KITTI's depth completion benchmark (Uhrig et al. 2017)."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.files.read_input import read_text
from runtime.geometry.calibration import Calibration
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.images import KITTI_DEPTH_SCALE
from training.base.limits import STRICT
from training.datasets.class_mapping import ClassTable
from training.datasets.files import dataset_errors, read_depth, require_files, require_folder
from training.datasets.recording import RecordedFrames, SetFrame, Truth, pair
from training.datasets.source_recipe import SourceRecipe


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiDepthRecipe(SourceRecipe):
    """Options of KITTI's depth completion benchmark in a recipe.

    Attributes:
        cameras: numbers of the cameras: 2 = left, 3 = right.
    """

    kind: Literal["kitti-depth"] = "kitti-depth"
    split: Literal["train", "val", "selection"] = "train"
    cameras: Annotated[tuple[Literal[2, 3], ...], Field(min_length=1, max_length=2)] = (2,)

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open LiDAR scans with semi-dense ground truth from eleven scans each; without classes.

        The splits "train" and "val" are in
        `<split>/<drive>/proj_depth/{velodyne_raw,groundtruth}/image_0<c>/<number>.png`, with the
        images of the raw data in `raw/<date>/<drive>/image_0<c>/data`. The benchmark leaves out
        the first and last five frames of each drive. "selection" is the selected validation set,
        in `val_selection_cropped/{image,velodyne_raw,groundtruth_depth,intrinsics}`.

        Raises:
            DatasetError: if a folder or a partner of an image is missing.
        """
        if self.split == "selection":
            return RecordedFrames(_list_selection(folder))
        return RecordedFrames(_list_drives(folder, self.split, self.cameras))


_read_truth = partial(read_depth, depth_scale=KITTI_DEPTH_SCALE)


def _rig(intrinsics: NDArray[np.float64] | None) -> Rig:
    return Rig(calibration=None if intrinsics is None else Calibration(intrinsics, np.eye(4)))


def _list_drives(root: Path, split: str, cameras: Sequence[int]) -> list[SetFrame]:
    folder = require_folder(root / split, "KITTI depth's drives")
    frames = []
    for drive in sorted(path for path in folder.iterdir() if path.is_dir()):
        date = "_".join(drive.name.split("_")[:3])
        for camera in cameras:
            side = f"image_{camera:02d}"
            truth = require_folder(drive / "proj_depth" / "groundtruth" / side, "ground truth")
            velodyne = drive / "proj_depth" / "velodyne_raw" / side
            images = root / "raw" / date / drive.name / side / "data"
            files = {path.stem: path for path in truth.glob("*.png")}
            require_files(velodyne, "LiDAR maps", sorted(files))
            require_files(images, "images of the raw data", sorted(files))
            calibration, intrinsics = root / "raw" / date / "calib_cam_to_cam.txt", None
            if calibration.is_file():
                matrix = NumbersFile(calibration).matrix(f"P_rect_{camera:02d}", 3, 4)
                intrinsics = matrix[:, :3]
            source = FolderSource(images, _rig(intrinsics), depth=velodyne)
            listed = [frame for frame in source.list_frames() if frame.name in files]
            name = f"{drive.name}/{camera}"
            frames += pair(source, listed, name, {"depth": Truth(files, _read_truth)})
    if not frames:
        raise DatasetError(f"{folder}: no drive with frames of cameras {list(cameras)} in it")
    return frames


def _list_selection(root: Path) -> list[SetFrame]:
    folder = require_folder(root / "val_selection_cropped", "KITTI's selected validation set")
    images = require_folder(folder / "image", "the selection's images")
    stems = sorted(path.stem for path in images.glob("*_image_0[23].png"))
    if not stems:
        raise DatasetError(f"{images}: no *_image_0<camera>.png in it")

    partners = {}
    for kind, word, suffix in (
        ("velodyne_raw", "velodyne_raw", ".png"),
        ("groundtruth_depth", "groundtruth_depth", ".png"),
        ("intrinsics", "image", ".txt"),
    ):
        # The drive's name does not contain "_image_", so the first one marks the kind of the file.
        names = [stem.replace("_image_", f"_{word}_", 1) for stem in stems]
        found = require_files(folder / kind, f"the selection's {kind}", names, "{}" + suffix)
        partners[kind] = found.values()
    frames = []
    for stem, lidar, truth, matrix in zip(stems, *partners.values(), strict=True):
        source = FolderSource(images / f"{stem}.png", _rig(_read_intrinsics(matrix)), depth=lidar)
        (listed,) = source.list_frames()
        frames.append(SetFrame(source, listed, stem, {"depth": (truth, _read_truth)}))
    return frames


def _read_intrinsics(path: Path) -> NDArray[np.float64]:
    try:
        return np.array(read_text(path).split(), np.float64).reshape(3, 3)
    except ValueError as error:
        raise DatasetError(f"{path}: expected nine numbers of a 3x3 matrix: {error}") from error
