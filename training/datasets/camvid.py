"""CamVid in the split and the eleven classes of the SegNet papers (Brostow et al. 2009)."""

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import list_images, read_gray, read_rgb, require_folder
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT

#: Labels by the files' ids; 11 is unlabelled.
_LABELS: tuple[str | None, ...] = (*(info.name for info in CLASS_TABLES["camvid"]), None)


class CamVidLabels:
    """Reads label files with CamVid's ids, uint8 PNG, as ids of a class table, 255 = ignored.

    Raises DatasetError for a table without a mapping.
    """

    def __init__(self, classes: ClassTable) -> None:
        self._lookup = id_lookup("camvid", classes, _LABELS)

    def read(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Read a file of this (height, width). Raises DatasetError for another file or id."""
        label = read_gray(path, np.uint8, size)
        if label.max() > 11:
            raise DatasetError(
                f"{path}: class id {label.max()}, expected 0..11 of the eleven-class labels."
            )
        mapped: NDArray[np.uint8] = self._lookup[label]
        return mapped


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CamVidRecipe(SourceRecipe):
    """Options of CamVid in a recipe."""

    kind: Literal["camvid"] = "camvid"
    #: train, val or test.
    split: str = "train"

    @property
    def label_table(self) -> ClassTable:
        """See `SourceRecipe.label_table`."""
        return "camvid"

    def open(self, folder: Path, classes: ClassTable) -> "CamVid":
        """See `SourceRecipe.open`."""
        return CamVid(folder, self, classes)


class CamVid(FrameList):
    """Frames of ``root/<split>`` with labels of ``root/<split>annot`` (uint8 PNG, 11 = none).

    It has no depth and no calibration.

    Raises:
        DatasetError: for a missing folder, an image without a label file, and unreadable or wrongly
            sized files.
    """

    def __init__(self, root: Path, recipe: CamVidRecipe, classes: ClassTable) -> None:
        self._labels = CamVidLabels(classes)
        images = list_images(root / recipe.split, "CamVid's images")
        annotations = root / f"{recipe.split}annot"
        labels = [f"{image.stem}.png" for image in images]
        require_folder(annotations, "CamVid's label images", files=labels)
        self._frames = [(image, annotations / f"{image.stem}.png") for image in images]
        self.images = images

    def __getitem__(self, index: int) -> Sample:
        image_path, label_path = self._frames[index]
        rgb = read_rgb(image_path)
        size = (rgb.shape[0], rgb.shape[1])
        return Sample(
            rgb=rgb,
            targets={"semantic": self._labels.read(label_path, size)},
            intrinsics=None,
            name=f"camvid/{image_path.stem}",
        )
