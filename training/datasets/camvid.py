"""CamVid in the split and the eleven classes of the SegNet papers (Brostow et al. 2009)."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import read_gray, read_rgb, require_folder
from training.datasets.sample import Sample, nothing_known
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT

#: Labels by the files' ids; 11 is unlabelled.
_LABELS: tuple[str | None, ...] = (*(info.name for info in CLASS_TABLES["camvid"]), None)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CamVidRecipe(SourceRecipe):
    """Options of CamVid in a recipe."""

    kind: Literal["camvid"] = "camvid"
    #: train, val or test.
    split: str = "train"

    def open(self, folder: Path, classes: ClassTable) -> "CamVid":
        """See `SourceRecipe.open`."""
        return CamVid(folder, split=self.split, classes=classes)


class CamVid:
    """Frames of ``root/<split>`` with labels of ``root/<split>annot`` (uint8 PNG, 11 = none).

    It has no depth and no calibration.

    Args:
        root: the folder.
        split: train, val or test.
        classes: table of the class ids.

    Raises:
        DatasetError: for a missing folder, an image without a label file, and unreadable or wrongly
            sized files.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        split: str = "train",
        classes: ClassTable = "camvid",
    ) -> None:
        self._lookup = id_lookup("camvid", classes, _LABELS)
        folder = require_folder(Path(root) / split, "CamVid's images")
        annotations = require_folder(Path(root) / f"{split}annot", "CamVid's label images")
        images = sorted(p for p in folder.iterdir() if p.suffix in {".png", ".jpg"})
        if not images:
            raise DatasetError(f"{folder}: no .png or .jpg images in it; expected CamVid's frames.")
        self._frames = [(image, annotations / f"{image.stem}.png") for image in images]
        missing = [label for _, label in self._frames if not label.is_file()]
        if missing:
            raise DatasetError(f"{missing[0]}: missing ({len(missing)} images lack their label).")

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sample:
        image_path, label_path = self._frames[index]
        rgb = read_rgb(image_path)
        label = read_gray(label_path, np.uint8, rgb.shape[:2])
        if label.max() > 11:
            raise DatasetError(
                f"{label_path}: class id {label.max()}, expected 0..11 of the eleven-class labels."
            )
        return Sample(
            rgb=rgb,
            depth=nothing_known(rgb.shape[:2]),
            semantic=self._lookup[label],
            intrinsics=None,
            name=f"camvid/{image_path.stem}",
        )
