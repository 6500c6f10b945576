"""CamVid in the split and the eleven classes of the SegNet papers (Brostow et al. 2009)."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from training.datasets.class_mapping import ClassTable, LabelFiles
from training.datasets.files import list_images, read_rgb, require_folder
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT

# Names of the labels in the order of the files' ids; 11 is unlabelled.
LABELS: tuple[str | None, ...] = (*(info.name for info in CLASS_TABLES["camvid"]), None)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CamVidRecipe(SourceRecipe):
    """Options of CamVid in a recipe.

    Attributes:
        split: "train", "val" or "test".
    """

    labelled: ClassVar[str] = "camvid"

    kind: Literal["camvid"] = "camvid"
    split: str = "train"

    def open(self, folder: Path, classes: ClassTable) -> "CamVid":
        """See `SourceRecipe.open`."""
        return CamVid(folder, self, classes)


class CamVid(FrameList):
    """Frames of `root/<split>` with labels of `root/<split>annot` (uint8 PNG, 11 = none).

    The set has no depth and no calibration.

    Raises:
        DatasetError: if a folder or the label file of an image is missing, or if a file is
            unreadable or has the wrong size.
    """

    def __init__(self, root: Path, recipe: CamVidRecipe, classes: ClassTable) -> None:
        self._labels = LabelFiles("camvid", classes, LABELS)
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
