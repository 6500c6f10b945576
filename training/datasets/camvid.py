"""CamVid in the split and the eleven classes of the SegNet papers (Brostow et al. 2009)."""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.recordings.folders import FolderSource
from training.base.limits import STRICT
from training.datasets.class_mapping import ClassTable, LabelReader, file_ids
from training.datasets.files import dataset_errors, require_files, require_folder
from training.datasets.recording import RecordedFrames, Truth, pair
from training.datasets.source_recipe import SourceRecipe

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

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open the images of `folder/<split>` with labels of `folder/<split>annot`.

        The labels are uint8 PNGs, 11 = none. The set has no depth and no calibration.

        Raises:
            DatasetError: if a folder or the label file of an image is missing.
        """
        source = FolderSource(require_folder(folder / self.split, "CamVid's images"))
        listed, annotations = source.list_frames(), folder / f"{self.split}annot"
        files = require_files(annotations, "CamVid's labels", [frame.name for frame in listed])
        labels = LabelReader(file_ids("camvid", classes, LABELS))
        return RecordedFrames(
            pair(source, listed, "camvid", {"semantic": Truth(files, labels.read)})
        )
