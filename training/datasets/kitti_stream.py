"""Recorded KITTI frames: the left colour camera, and LiDAR returns with their scan lines."""

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.source import ListedFrame
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import dataset_errors, read_gray, require_folder
from training.datasets.recording import RecordedFrames, Targets
from training.datasets.source_recipe import RangeRecipe
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


class KittiStream(RecordedFrames):
    """Frames of a stream folder.

    The folder has `image_02` (PNG or JPEG), `velodyne_fov`, `calib_cam_to_cam.txt` and
    `calib_velo_to_cam.txt` as in KITTI raw and, optionally, `pseudo_semantic` (Cityscapes trainIds
    that a network made). A folder with `calib` has the layout of KITTI's object data: `image_2`,
    one calibration per frame, and returns for some of the frames. The depth target is every return
    in view, with its scan line, so that some lines can be the input and the others the target.

    Raises:
        DatasetError: if a folder or file is missing or damaged.
    """

    @dataset_errors()
    def __init__(self, root: Path, recipe: KittiStreamRecipe, classes: ClassTable) -> None:
        self._lookup = id_lookup("cityscapes", classes, TRAIN_LABELS)
        self._labels = root / "pseudo_semantic"
        is_object = (root / "calib").is_dir()
        images = root / ("image_2" if is_object else "image_02")
        scans = require_folder(root / "velodyne_fov", "the stream's .bin LiDAR returns")
        source = FolderSource(
            require_folder(images, "the recording's images"),
            Rig(calibration=root / "calib" if is_object else root),
            points=scans,
            camera=2,
        )
        source.camera_alone = is_object
        listed = recipe.take([f for f in source.list_frames() if f.image is not None], images)
        if not is_object:
            require_folder(scans, "returns", files=[f"{frame.name}.bin" for frame in listed])
        name = "kitti_object" if is_object else "kitti_stream"
        super().__init__(
            [(source, frame, f"{name}/{frame.name}") for frame in listed],
            "ordered",
            {"semantic": recipe.semantic_weight},
        )

    def _read_truth(self, listed: ListedFrame, size: tuple[int, int]) -> Targets:
        path = self._labels / f"{listed.name}.png"
        if not path.is_file():
            return {}
        return {"semantic": self._lookup[read_gray(path, np.uint8, size)]}
