"""Streets of KITTI stereo 2015 (Menze and Geiger 2015), each with its whole LiDAR scan."""

from bisect import bisect_right
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import NO_CLASS
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.images import list_files
from training.base.limits import STRICT
from training.datasets.camvid import LABELS
from training.datasets.cityscapes import disparity_to_depth
from training.datasets.class_mapping import ClassTable, LabelReader, file_ids
from training.datasets.files import dataset_errors, read_gray, require_files, require_folder
from training.datasets.recording import RecordedFrames, Truth, pair
from training.datasets.source_recipe import RangeRecipe

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

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open the frames `folder/image_02/<number>.jpg` or .png.

        The returns are the scan of the frame, `velodyne_fov/<number>.bin`, with its scan lines. The
        truth is `disp_occ_0/<number>.png`, a stereo disparity of d = p / 256 px for a 16-bit pixel
        p > 0, measured by seven scans and by models that were fitted to moving cars; depth is
        `fb_disp` / d. `calib.txt` has P2, R0_rect, Tr_velo_to_cam and fb_disp (focal length times
        baseline, px m) of all frames. Two folders of `<number>.png` are optional. `road_mask`, for
        all frames, holds 0 = not road, 1 = road, 255 = unknown. `semantic`, for some frames, holds
        hand-made labels in CamVid's ids, 11 = unknown; they are not read if the class table has no
        mapping of them.

        Raises:
            DatasetError: if a folder, file or calibration is missing, if no frame has these
                numbers, or if the folder of labels is empty.
        """
        images = require_folder(folder / "image_02", "the streets' images")
        scans = require_folder(folder / "velodyne_fov", "velodyne_fov's .bin files")
        source = FolderSource(images, Rig(calibration=folder / "calib.txt"), points=scans, camera=2)
        found = [
            frame
            for frame in source.list_frames()
            if frame.image is not None and frame.name.isdecimal()
        ]
        taken = self.take(found, images, lambda frame: int(frame.name))
        names = [frame.name for frame in taken]
        require_files(scans, "velodyne_fov's .bin files", names, "{}.bin")
        disparities = require_files(folder / "disp_occ_0", "the disparities", names)
        calibration, truth = folder / "calib.txt", dict[str, Truth]()
        focal_baseline = float(NumbersFile(calibration).matrix("fb_disp", 1, 1)[0, 0])
        if not focal_baseline > 0:
            raise DatasetError(
                f"{calibration}: fb_disp is {focal_baseline}, expected a positive number"
            )
        if self.truth == "accumulated":
            truth["depth"] = Truth(disparities, partial(_read_disparity, focal_baseline))
        if (folder / "road_mask").is_dir():
            masks = require_files(folder / "road_mask", "the road's masks", names)
            truth["road_mask"] = Truth(masks, _read_mask)
        if (folder / "semantic").is_dir():
            labels = list_files(folder / "semantic")
            with suppress(DatasetError):  # with another table, depth and road remain
                ids = file_ids("camvid", classes, LABELS)
                truth["semantic"] = Truth(labels, LabelReader(ids).read)
        frames = []
        for frame in pair(source, taken, "kitti_streets", truth):
            place = _place(int(frame.listed.name))
            facts = {"focal_baseline_px_m": focal_baseline, "place": place}
            frames.append(frame._replace(facts=facts))
        return RecordedFrames(frames, "ordered")


def _read_disparity(
    focal_baseline: float, path: Path, size: tuple[int, int]
) -> NDArray[np.float32]:
    return disparity_to_depth(read_gray(path, np.uint16, size), focal_baseline, zero=0)


def _read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a mask: 0 = not road, 1 = road, 255 = unknown."""
    mask: NDArray[np.uint8] = read_gray(path, np.uint8, size)
    other = np.setdiff1d(mask, (0, 1, NO_CLASS))
    if other.size:
        raise DatasetError(
            f"{path}: holds the value {other[0]}: write 0 = not road, 1 = road, 255 = unknown"
        )
    return mask


def _place(number: int) -> str | None:
    """Name the place of a validation frame by its first frame; None for the other frames."""
    index = bisect_right(_PLACES, number)
    return f"{_PLACES[index - 1]:06d}" if 0 < index < len(_PLACES) else None
