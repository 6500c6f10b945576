"""The frames of Virtual KITTI for training, validation and test."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from runtime.base.errors import DatasetError
from training.datasets.files import list_names

Split = Literal["train", "val", "test", "all"]

# The paper uses eight of the ten variants without naming them. These are the variants whose camera
# angle is closest to the recorded camera.
PAPER_VARIANTS = (
    "15-deg-left",
    "15-deg-right",
    "clone",
    "fog",
    "morning",
    "overcast",
    "rain",
    "sunset",
)
_TEST_SCENE = 1  # 447 frames per variant; 3,576 in all, as in the paper
_VAL_SCENE, _VAL_FIRST = 20, 547  # the last 290 of its 837 frames; 2,320 in all, as in the paper


@dataclass(frozen=True)
class Selection:
    """Which frames of a set to take.

    Attributes:
        split: "train", "val" and "test" have the paper's sizes (11,112 / 2,320 / 3,576). Scene01 is
            the test set, the last 290 frames of Scene20 are the validation set, and all others,
            including the start of Scene20, are the training set. "all" is every frame.
        scenes: names of scenes that replace those of the split.
        variants: names of variants that replace those of the split.
    """

    split: Split = "all"
    scenes: tuple[str, ...] | None = None
    variants: tuple[str, ...] | None = None

    def takes_variant(self, scene: str, variant: str) -> bool:
        """Whether any frame of a variant of a scene may be taken."""
        if self.variants is not None:
            known = variant in self.variants
        else:
            known = self.split == "all" or variant in PAPER_VARIANTS
        return known and (self.scenes is None or scene in self.scenes)

    def takes(self, scene: str, number: str) -> bool:
        """Whether a frame belongs to the split, in a variant that belongs to it."""
        if self.split == "all" or self.scenes is not None:
            return True
        scene_number = int("".join(filter(str.isdigit, scene)) or 0)
        is_val = scene_number == _VAL_SCENE and int(number) >= _VAL_FIRST
        if self.split == "val":
            return is_val
        return (scene_number == _TEST_SCENE) == (self.split == "test") and not is_val

    def require_frames(self, found: Sequence[object], variants: Sequence[Path], root: Path) -> None:
        """Raise DatasetError if no frame was found in the folders of the variants."""
        if not found:
            there = [f"{variant.parent.name}/{variant.name}" for variant in variants]
            raise DatasetError(
                f"{root}: no frames of the split {self.split!r} in "
                f"{', '.join(self.scenes or ['its scenes'])} with "
                f"{', '.join(self.variants or ['its variants'])}: choose among those there, "
                f"{list_names(there)}"
            )
