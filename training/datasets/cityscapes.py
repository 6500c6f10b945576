"""Cityscapes (Cordts et al. 2016): fine labels, and depth from its stereo disparity."""

import json
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.base.errors import DatasetError
from runtime.files.read_input import read_text
from training.base.limits import STRICT
from training.datasets.class_mapping import ClassTable, LabelReader, file_ids
from training.datasets.files import (
    dataset_errors,
    read_gray,
    read_rgb,
    require_files,
    require_folder,
)
from training.datasets.sample import FrameList, Sample, make_frame
from training.datasets.source_recipe import SourceRecipe

# The classes in the order of their trainIds 0..18.
TRAIN_LABELS: tuple[str | None, ...] = tuple(info.name for info in CLASS_TABLES["cityscapes"])
# The labelId of each class; the other labelIds of 0..33 are ignored.
_LABEL_IDS = (7, 8, 11, 12, 13, 17, *range(19, 29), 31, 32, 33)
# The classes in the order of their labelIds.
_LABELS = tuple(dict(zip(_LABEL_IDS, TRAIN_LABELS, strict=True)).get(id_) for id_ in range(34))

# How the names of the files in each folder end; the stereo folders are optional.
_SUFFIXES = {
    "leftImg8bit": "_leftImg8bit.png",
    "gtFine": "_gtFine_labelIds.png",
    "disparity": "_disparity.png",
    "camera": "_camera.json",
}


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CityscapesRecipe(SourceRecipe):
    """Options of Cityscapes in a recipe.

    Attributes:
        split: "train", "val" or "test".
    """

    labelled: ClassVar[str] = "cityscapes"

    kind: Literal["cityscapes"] = "cityscapes"
    split: str = "train"

    def open(self, folder: Path, classes: ClassTable) -> "Cityscapes":
        """See `SourceRecipe.open`."""
        return Cityscapes(folder, self, classes)


class Cityscapes(FrameList):
    """Frames of `root/leftImg8bit/<split>/<city>/<frame>_leftImg8bit.png`.

    The labels are those of `gtFine` (`_gtFine_labelIds.png`). With the folders `disparity` and
    `camera`, depth is baseline * fx / d, with the disparity d = (p - 1) / 256 px of a 16-bit pixel
    p > 0. Without them, depth is unknown.

    Raises:
        DatasetError: if a folder or a partner of an image is missing, an id is unknown, a size is
            wrong, or a camera file is incomplete.
    """

    def __init__(self, root: Path, recipe: CityscapesRecipe, classes: ClassTable) -> None:
        images = require_folder(
            root / "leftImg8bit" / recipe.split, "Cityscapes' images, one folder per city"
        )
        self._labels = LabelReader(file_ids("cityscapes", classes, _LABELS))
        self._name = f"cityscapes/{recipe.split}"
        with_depth = (root / "disparity").is_dir()
        self._frames: list[dict[str, Path]] = []
        for city in sorted(path.name for path in images.iterdir() if path.is_dir()):
            found = (images / city).glob(f"*{_SUFFIXES['leftImg8bit']}")
            stems = sorted(path.name.removesuffix(_SUFFIXES["leftImg8bit"]) for path in found)
            files = {
                kind: require_files(
                    root / kind / recipe.split / city, f"{kind}'s files", stems, "{}" + suffix
                )
                for kind, suffix in _SUFFIXES.items()
                if with_depth or kind not in ("disparity", "camera")
            }
            self._frames += [{kind: files[kind][stem] for kind in files} for stem in stems]
        if not self._frames:
            raise DatasetError(f"{images}: no <city>/*{_SUFFIXES['leftImg8bit']} in it")
        self.images = [paths["leftImg8bit"] for paths in self._frames]

    def __getitem__(self, index: int) -> Sample:
        paths = self._frames[index]
        stem = paths["leftImg8bit"].name.removesuffix(_SUFFIXES["leftImg8bit"])
        rgb = read_rgb(paths["leftImg8bit"])
        size = (rgb.shape[0], rgb.shape[1])
        targets: dict[str, NDArray[Any]] = {"semantic": self._labels.read(paths["gtFine"], size)}
        intrinsics = focal_baseline = None
        if "camera" in paths:
            intrinsics, focal_baseline = _read_camera(paths["camera"])
            stored = read_gray(paths["disparity"], np.uint16, size)
            targets["depth"] = disparity_to_depth(stored, focal_baseline)
        frame = make_frame(rgb, f"{self._name}/{stem}", intrinsics=intrinsics)
        return Sample(frame, targets, focal_baseline_px_m=focal_baseline)


def disparity_to_depth(
    stored: NDArray[np.uint16], focal_baseline: float, *, zero: int = 1
) -> NDArray[np.float32]:
    """Convert a disparity image of Cityscapes, or one with another `zero`, to depth.

    Args:
        stored: uint16 (H, W); a pixel p > 0 has the disparity d = (p - zero) / 256 px. A disparity
            of 0 is at infinity and counts as no measurement.
        focal_baseline: fx * baseline [px m].
        zero: the value of a disparity of 0.

    Returns:
        float32 (H, W), metres, 0 = no measurement.
    """
    disparity = (stored.astype(np.float32) - zero) / 256.0
    depth = np.zeros(stored.shape, dtype=np.float32)
    np.divide(np.float32(focal_baseline), disparity, out=depth, where=disparity > 0)
    return depth


@dataset_errors()
def _read_camera(path: Path) -> tuple[NDArray[np.float64], float]:
    """Return K (3, 3) and fx * baseline [px m] of a camera file."""
    try:
        document = json.loads(read_text(path))
        camera, baseline = document["intrinsic"], float(document["extrinsic"]["baseline"])
        fx, fy, u0, v0 = (float(camera[key]) for key in ("fx", "fy", "u0", "v0"))
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: expected JSON with intrinsic fx, fy, u0, v0 and extrinsic baseline "
            f"({type(error).__name__}: {error}): restore the original file"
        ) from error
    if not (baseline > 0 and fx > 0 and fy > 0):
        raise DatasetError(
            f"{path}: baseline {baseline}, fx {fx}, fy {fy}, all expected above 0: restore the file"
        )
    return np.array([[fx, 0, u0], [0, fy, v0], [0, 0, 1]], np.float64), fx * baseline
