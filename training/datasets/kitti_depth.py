"""KITTI's depth completion benchmark (Uhrig et al. 2017)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from runtime.base.errors import DatasetError
from runtime.files.read_input import read_text
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.recordings.images import KITTI_DEPTH_SCALE
from training.datasets.class_mapping import ClassTable
from training.datasets.files import dataset_errors, read_depth, read_rgb, require_folder
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT


@checked_dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiDepthRecipe(SourceRecipe):
    """Options of KITTI's depth completion benchmark in a recipe.

    Attributes:
        cameras: numbers of the cameras: 2 = left, 3 = right.
    """

    kind: Literal["kitti-depth"] = "kitti-depth"
    split: Literal["train", "val", "selection"] = "train"
    cameras: Annotated[tuple[Literal[2, 3], ...], Field(min_length=1, max_length=2)] = (2,)

    def open(self, folder: Path, classes: ClassTable) -> "KittiDepth":
        """See `SourceRecipe.open`; there are no classes."""
        return KittiDepth(folder, self)


@dataclass(frozen=True)
class _Frame:
    image: Path
    velodyne: Path
    groundtruth: Path
    name: str
    intrinsics: NDArray[np.float64] | None


class KittiDepth(FrameList):
    """LiDAR scans with semi-dense ground truth from eleven scans each; there are no classes.

    The splits "train" and "val" are in
    `root/<split>/<drive>/proj_depth/{velodyne_raw,groundtruth}/image_0<c>/<number>.png`, with the
    images of the raw data in `root/raw/<date>/<drive>/image_0<c>/data`. The benchmark leaves out
    the first and last five frames of each drive. "selection" is the selected validation set, in
    `root/val_selection_cropped/{image,velodyne_raw,groundtruth_depth,intrinsics}`.

    Raises:
        DatasetError: if a folder or a partner of an image is missing, or if a file has another kind
            or size.
    """

    @dataset_errors()
    def __init__(self, root: Path, recipe: KittiDepthRecipe) -> None:
        if recipe.split == "selection":
            self._frames = _list_selection(root)
        else:
            self._frames = _list_drives(root, recipe.split, recipe.cameras)
        self.images = [frame.image for frame in self._frames]

    def __getitem__(self, index: int) -> Sample:
        frame = self._frames[index]
        rgb = read_rgb(frame.image)
        size = (rgb.shape[0], rgb.shape[1])
        return Sample(
            rgb=rgb,
            targets={"depth": read_depth(frame.groundtruth, size, depth_scale=KITTI_DEPTH_SCALE)},
            intrinsics=frame.intrinsics,
            name=frame.name,
            sparse_depth=read_depth(frame.velodyne, size, depth_scale=KITTI_DEPTH_SCALE),
        )


def _list_drives(root: Path, split: str, cameras: Sequence[int]) -> list[_Frame]:
    folder = require_folder(root / split, "KITTI depth's drives")
    frames = []
    for drive in sorted(path for path in folder.iterdir() if path.is_dir()):
        date = "_".join(drive.name.split("_")[:3])
        for camera in cameras:
            side = f"image_{camera:02d}"
            truth = require_folder(drive / "proj_depth" / "groundtruth" / side, "ground truth")
            velodyne = drive / "proj_depth" / "velodyne_raw" / side
            images = root / "raw" / date / drive.name / side / "data"
            names = sorted(path.name for path in truth.glob("*.png"))
            require_folder(velodyne, "LiDAR maps", files=names)
            require_folder(images, "images of the raw data", files=names)
            calibration, intrinsics = root / "raw" / date / "calib_cam_to_cam.txt", None
            if calibration.is_file():
                matrix = NumbersFile(calibration).matrix(f"P_rect_{camera:02d}", 3, 4)
                intrinsics = matrix[:, :3]
            frames += [
                _Frame(
                    images / name,
                    velodyne / name,
                    truth / name,
                    f"{drive.name}/{camera}/{Path(name).stem}",
                    intrinsics,
                )
                for name in names
            ]
    if not frames:
        raise DatasetError(f"{folder}: no drive with frames of cameras {list(cameras)} in it")
    return frames


def _list_selection(root: Path) -> list[_Frame]:
    folder = require_folder(root / "val_selection_cropped", "KITTI's selected validation set")
    images = require_folder(folder / "image", "the selection's images")
    stems = sorted(path.stem for path in images.glob("*_image_0[23].png"))
    if not stems:
        raise DatasetError(f"{images}: no *_image_0<camera>.png in it")

    partners = []
    for kind, word, suffix in (
        ("velodyne_raw", "velodyne_raw", ".png"),
        ("groundtruth_depth", "groundtruth_depth", ".png"),
        ("intrinsics", "image", ".txt"),
    ):
        # The drive's name does not contain "_image_", so the first one marks the kind of the file.
        names = [stem.replace("_image_", f"_{word}_", 1) + suffix for stem in stems]
        other = require_folder(folder / kind, f"the selection's {kind}", files=names)
        partners.append([other / name for name in names])
    return [
        _Frame(images / f"{stem}.png", lidar, depth, stem, _read_intrinsics(matrix))
        for stem, lidar, depth, matrix in zip(stems, *partners, strict=True)
    ]


def _read_intrinsics(path: Path) -> NDArray[np.float64]:
    try:
        return np.array(read_text(path).split(), np.float64).reshape(3, 3)
    except ValueError as error:
        raise DatasetError(f"{path}: expected nine numbers of a 3x3 matrix: {error}") from error
