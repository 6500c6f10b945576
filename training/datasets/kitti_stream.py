"""Recorded KITTI frames: the left colour camera, and LiDAR returns with their scan lines."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic.dataclasses import dataclass

from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from training.base.limits import STRICT, Share
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, LabelReader, file_ids
from training.datasets.files import dataset_errors, require_files, require_folder
from training.datasets.recording import RecordedFrames, Truth, pair
from training.datasets.source_recipe import RangeRecipe


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiStreamRecipe(RangeRecipe):
    """Options of a recorded KITTI stream in a recipe.

    Attributes:
        semantic_weight: weight of the labels, which a network made.
    """

    labelled: ClassVar[str] = "cityscapes"

    kind: Literal["kitti-stream"] = "kitti-stream"
    semantic_weight: Share = 1.0

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open the frames of a stream folder.

        The folder has `image_02` (PNG or JPEG), `velodyne_fov`, `calib_cam_to_cam.txt` and
        `calib_velo_to_cam.txt` as in KITTI raw and, optionally, `pseudo_semantic` (Cityscapes
        trainIds that a network made). A folder with `calib` has the layout of KITTI's object data:
        `image_2`, one calibration per frame, and returns for some of the frames. Every return in
        view has its scan line, so that some lines can be the input and the others the target.

        Raises:
            DatasetError: if a folder or file is missing or damaged.
        """
        # Other ids than trainIds are ignored.
        order = (*TRAIN_LABELS, *[None] * (256 - len(TRAIN_LABELS)))
        labels = LabelReader(file_ids("cityscapes", classes, order))
        is_object = (folder / "calib").is_dir()
        name = "image_2" if is_object else "image_02"
        images = require_folder(folder / name, "the recording's images")
        scans = require_folder(folder / "velodyne_fov", "the stream's .bin LiDAR returns")
        rig = Rig(calibration=folder / "calib" if is_object else folder)
        source = FolderSource(images, rig, points=scans, camera=2)
        source.camera_alone = is_object
        listed = self.take([f for f in source.list_frames() if f.image is not None], images)
        if not is_object:
            require_files(scans, "returns", [frame.name for frame in listed], "{}.bin")
        name = "kitti_object" if is_object else "kitti_stream"
        files = {path.stem: path for path in (folder / "pseudo_semantic").glob("*.png")}
        paired = pair(source, listed, name, {"semantic": Truth(files, labels.read)})
        return RecordedFrames(paired, "ordered", semantic_weight=self.semantic_weight)
