"""Recorded KITTI frames: left colour camera, LiDAR returns with their scan lines."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from runtime.io.calibration import Calibration
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import dataset_errors, read_gray, read_points, read_rgb, require_folder
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.lidar.scan import project_lines
from training.limits import STRICT, Index, Share


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiStreamRecipe(SourceRecipe):
    """Options of a recorded KITTI stream in a recipe."""

    kind: Literal["kitti-stream"] = "kitti-stream"
    #: First and last frame, inclusive.
    first: Index = 0
    last: Index | None = None
    #: Weight of the labels, which were made by a network.
    semantic_weight: Share = 1.0

    @property
    def label_table(self) -> ClassTable:
        """See `SourceRecipe.label_table`."""
        return "cityscapes"

    def open(self, folder: Path, classes: ClassTable) -> "KittiStream":
        """See `SourceRecipe.open`."""
        return KittiStream(
            folder,
            first=self.first,
            last=self.last,
            semantic_weight=self.semantic_weight,
            classes=classes,
        )


class KittiStream(FrameList):
    """Frames ``first`` .. ``last`` (inclusive) of a stream folder.

    It has ``image_02`` (PNG or JPEG), ``velodyne_fov``, ``calib_cam_to_cam.txt`` and
    ``calib_velo_to_cam.txt`` as in KITTI raw and, optionally, ``pseudo_semantic`` (Cityscapes
    trainIds made by a network). A folder with ``calib`` is in the layout of KITTI's object data:
    ``image_2``, one calibration per frame, and returns for some of the frames. The depth target is
    every return in view, with its scan line, so that some lines can be the input and the others the
    target.

    Args:
        root: the folder.
        first: first frame.
        last: last frame; None: the stream's last.
        semantic_weight: weight of the labels in the loss.
        classes: table of the class ids.

    Raises:
        DatasetError: for missing folders or files, and damaged ones.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        first: int = 0,
        last: int | None = None,
        semantic_weight: float = 1.0,
        classes: ClassTable = "camvid",
    ) -> None:
        self._lookup = id_lookup("cityscapes", classes, TRAIN_LABELS)
        self._root = Path(root)
        self._calibration = None  # one file per frame
        if not (self._root / "calib").is_dir():
            images = require_folder(self._root / "image_02", "the stream's images")
            require_folder(self._root / "velodyne_fov", "the stream's .bin LiDAR returns")
            self._calibration = _read_calibration(self._root)
        else:
            images = require_folder(self._root / "image_2", "the object data's images")
        self._name = "kitti_object" if self._calibration is None else "kitti_stream"
        found = sorted(path for path in images.iterdir() if path.suffix in {".jpg", ".png"})
        self._frames = found[first : None if last is None else last + 1]
        if not self._frames:
            raise DatasetError(f"{images}: {len(found)} frames, none of them in {first}..{last}.")
        self._semantic_weight = semantic_weight

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
            weights={"semantic": self._semantic_weight},
        )


_read_calibration = dataset_errors()(Calibration.from_kitti)
