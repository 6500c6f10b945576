"""Streets of KITTI stereo 2015 (Menze and Geiger 2015), each with its whole LiDAR scan."""

import contextlib
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.source import ListedFrame
from training.datasets.camvid import LABELS
from training.datasets.cityscapes import disparity_to_depth
from training.datasets.class_mapping import ClassTable, LabelFiles
from training.datasets.files import dataset_errors, list_images, read_gray, require_folder
from training.datasets.recording import RecordedFrames, Targets
from training.datasets.sample import IGNORE, Sample
from training.datasets.source_recipe import RangeRecipe
from training.limits import STRICT

# Places of the validation frames: each begins with one of these numbers and ends before the next.
_PLACES = (70, 71, 72, 83, 84, 85, 88, 89, 99)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiStreetsRecipe(RangeRecipe):
    """Options of KITTI's streets in a recipe; `first` and `last` are numbers of frames.

    Neighbouring frames often show the same place, so train and validate on different blocks of
    numbers.

    Attributes:
        truth: the depth target: seven accumulated scans with models of cars, or the frame's own
            returns, a part of which is then the input.
    """

    labelled: ClassVar[str] = "camvid"

    kind: Literal["kitti-streets"] = "kitti-streets"
    truth: Literal["accumulated", "scan"] = "accumulated"

    def open(self, folder: Path, classes: ClassTable) -> "KittiStreets":
        """See `SourceRecipe.open`."""
        return KittiStreets(folder, self, classes)


class KittiStreets(RecordedFrames):
    """Frames `root/image_02/<number>.jpg` or .png.

    The input is the scan of the frame, `velodyne_fov/<number>.bin`, with its scan lines. The target
    is `disp_occ_0/<number>.png`, a stereo disparity of d = p / 256 px for a 16-bit pixel p > 0,
    measured by seven scans and by models that were fitted to moving cars; depth is `fb_disp` / d.
    `calib.txt` has P2, R0_rect, Tr_velo_to_cam and fb_disp (focal length times baseline, px m) of
    all frames. Two folders of `<number>.png` are optional. `road_mask`, for all frames, holds 0 =
    not road, 1 = road, 255 = unknown. `semantic`, for some frames, holds hand-made labels in
    CamVid's ids, 11 = unknown; they are not read if the class table has no mapping of them.

    Raises:
        DatasetError: if a folder, file or calibration is missing, if no frame has these numbers, if
            a file has another kind or size, if a mask or labels have other values, or if the folder
            of labels is empty.
    """

    @dataset_errors()
    def __init__(self, root: Path, recipe: KittiStreetsRecipe, classes: ClassTable) -> None:
        self._root, self._truth = root, recipe.truth
        images = require_folder(root / "image_02", "the streets' images")
        scans = require_folder(root / "velodyne_fov", "velodyne_fov's .bin files")
        source = FolderSource(images, Rig(calibration=root / "calib.txt"), points=scans, camera=2)
        found = [
            frame
            for frame in source.list_frames()
            if frame.image is not None and frame.name.isdecimal()
        ]
        taken = recipe.take(found, images, lambda frame: int(frame.name))
        folders = {"velodyne_fov": ".bin", "disp_occ_0": ".png"}
        self._has_masks = (root / "road_mask").is_dir()
        if self._has_masks:
            folders["road_mask"] = ".png"
        for folder, suffix in folders.items():
            files = [f"{frame.name}{suffix}" for frame in taken]
            require_folder(root / folder, f"{folder}'s {suffix} files", files=files)
        self._labels: LabelFiles | None = None
        if (root / "semantic").is_dir():
            list_images(root / "semantic", "labels")
            with contextlib.suppress(DatasetError):  # with another table, depth and road remain
                self._labels = LabelFiles("camvid", classes, LABELS)
        self._focal_baseline = _read_focal_baseline(root / "calib.txt")
        super().__init__(
            [(source, frame, f"kitti_streets/{frame.name}") for frame in taken], "ordered"
        )

    def __getitem__(self, index: int) -> Sample:
        place = _place(int(self._frames[index][1].name))
        return replace(
            super().__getitem__(index), focal_baseline_px_m=self._focal_baseline, place=place
        )

    def _read_truth(self, listed: ListedFrame, size: tuple[int, int]) -> Targets:
        file, targets = f"{listed.name}.png", Targets()
        if self._truth == "accumulated":
            disparity = read_gray(self._root / "disp_occ_0" / file, np.uint16, size)
            targets["depth"] = disparity_to_depth(disparity, self._focal_baseline, zero=0)
        labels = self._root / "semantic" / file
        if self._labels is not None and labels.exists():
            targets["semantic"] = self._labels.read(labels, size)
        if self._has_masks:
            targets["road_mask"] = _read_mask(self._root / "road_mask" / file, size)
        return targets


def _read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a mask: 0 = not road, 1 = road, 255 = unknown."""
    mask: NDArray[np.uint8] = read_gray(path, np.uint8, size)
    other = np.setdiff1d(mask, (0, 1, IGNORE))
    if other.size:
        raise DatasetError(
            f"{path}: holds the value {other[0]}; expected 0 = not road, 1 = road, 255 = unknown"
        )
    return mask


def _place(number: int) -> str | None:
    """Name the place of a validation frame by its first frame; None for the other frames."""
    index = bisect_right(_PLACES, number)
    return f"{_PLACES[index - 1]:06d}" if 0 < index < len(_PLACES) else None


def _read_focal_baseline(path: Path) -> float:
    """Return the focal length times the baseline [px m]."""
    focal_baseline = float(NumbersFile(path).matrix("fb_disp", 1, 1)[0, 0])
    if not focal_baseline > 0:
        raise DatasetError(f"{path}: fb_disp is {focal_baseline}, expected a positive number")
    return focal_baseline
