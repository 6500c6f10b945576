"""Recorded KITTI frames: the left colour camera, and LiDAR returns with their scan lines."""

from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from runtime.geometry.calibration import Calibration
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import (
    dataset_errors,
    list_images,
    read_gray,
    read_points,
    read_rgb,
    require_folder,
)
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import RangeRecipe
from training.lidar.scan import project_lines
from training.limits import STRICT, Share


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiStreamRecipe(RangeRecipe):
    """Options of a recorded KITTI stream in a recipe.

    Attributes:
        semantic_weight: weight of the labels, which a network made.
    """

    labelled: ClassVar[str] = "cityscapes"

    kind: Literal["kitti-stream"] = "kitti-stream"
    semantic_weight: Share = 1.0

    def open(self, folder: Path, classes: ClassTable) -> "KittiStream":
        """See `SourceRecipe.open`."""
        return KittiStream(folder, self, classes)


class KittiStream(FrameList):
    """Frames of a stream folder.

    The folder has `image_02` (PNG or JPEG), `velodyne_fov`, `calib_cam_to_cam.txt` and
    `calib_velo_to_cam.txt` as in KITTI raw and, optionally, `pseudo_semantic` (Cityscapes trainIds
    that a network made). A folder with `calib` has the layout of KITTI's object data: `image_2`,
    one calibration per frame, and returns for some of the frames. The depth target is every return
    in view, with its scan line, so that some lines can be the input and the others the target.

    Raises:
        DatasetError: if a folder or file is missing or damaged.
    """

    def __init__(self, root: Path, recipe: KittiStreamRecipe, classes: ClassTable) -> None:
        self._lookup = id_lookup("cityscapes", classes, TRAIN_LABELS)
        self._root = root
        self._calibration = None  # there is one file per frame
        if not (self._root / "calib").is_dir():
            require_folder(self._root / "velodyne_fov", "the stream's .bin LiDAR returns")
            self._calibration = _read_calibration(self._root)
        self._name = "kitti_object" if self._calibration is None else "kitti_stream"
        images = root / ("image_2" if self._calibration is None else "image_02")
        self._frames = recipe.take(list_images(images, "the recording's images"), images)
        self.images = self._frames
        self._weights = {"semantic": recipe.semantic_weight}

    def __getitem__(self, index: int) -> Sample:
        path = self._frames[index]
        rgb = read_rgb(path)
        size = (rgb.shape[0], rgb.shape[1])
        camera = self._calibration or _read_calibration(self._root / "calib" / f"{path.stem}.txt")
        targets: dict[str, NDArray[Any]] = {}
        scan, scan_line = self._root / "velodyne_fov" / f"{path.stem}.bin", None
        if self._calibration is not None or scan.is_file():
            targets["depth"], scan_line = project_lines(
                read_points(scan), camera.intrinsics, camera.extrinsics, size
            )
        label_path = self._root / "pseudo_semantic" / f"{path.stem}.png"
        if label_path.is_file():
            targets["semantic"] = self._lookup[read_gray(label_path, np.uint8, size)]
        return Sample(
            rgb=rgb,
            targets=targets,
            intrinsics=camera.intrinsics,
            name=f"{self._name}/{path.stem}",
            scan_line=scan_line,
            weights=self._weights,
        )


_read_calibration = dataset_errors()(Calibration.from_kitti)
