"""The frames of Virtual KITTI for training, validation and test."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from runtime.errors import DatasetError
from runtime.read_input import read_text
from training.datasets.files import dataset_errors, list_names

Split = Literal["train", "val", "test", "all"]

#: The paper uses eight of the ten variants without naming them. Here they are the variants whose
#: camera angle is closest to the recorded camera.
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
_TEST_SCENE = 1  # 447 frames a variant, the paper's 3,576 in all
_VAL_SCENE, _VAL_FIRST = 20, 547  # the last 290 of its 837 frames: the paper's 2,320 in all
_VAL = f"frames of scene {_VAL_SCENE} from {_VAL_FIRST} on"
#: Split -> its frames, for messages.
_FRAMES = {
    "train": f"all but scene {_TEST_SCENE} and the {_VAL}",
    "val": f"the {_VAL}",
    "test": f"scene {_TEST_SCENE}",
    "all": "all scenes",
}


@dataclass(frozen=True)
class Selection:
    """Which frames of a set to take.

    Attributes:
        split: "train", "val" and "test" have the paper's sizes (11,112 / 2,320 / 3,576): Scene01 is
            the test, the last 290 frames of Scene20 are for validation, and all others, the start
            of that street included, are for training; "all" is every frame.
        scenes: by name, in place of the split's.
        variants: by name, in place of the split's.
        frames: rows of "scene/variant/number", in place of all the others.
    """

    split: Split = "all"
    scenes: tuple[str, ...] | None = None
    variants: tuple[str, ...] | None = None
    frames: frozenset[str] | None = None

    def takes_variant(self, scene: str, variant: str) -> bool:
        """Whether any frame of a variant of a scene may be taken."""
        if self.frames is not None:
            return any(frame.startswith(f"{scene}/{variant}/") for frame in self.frames)
        if self.variants is not None:
            known = variant in self.variants
        else:
            known = self.split == "all" or variant in PAPER_VARIANTS
        return known and (self.scenes is None or scene in self.scenes)

    def takes(self, scene: str, variant: str, number: str) -> bool:
        """Whether a frame belongs to the split, in a variant that belongs to it."""
        if self.frames is not None:
            return f"{scene}/{variant}/{number}" in self.frames
        if self.split == "all" or self.scenes is not None:
            return True
        scene_number = int("".join(filter(str.isdigit, scene)) or 0)
        is_val = scene_number == _VAL_SCENE and int(number) >= _VAL_FIRST
        if self.split == "val":
            return is_val
        return (scene_number == _TEST_SCENE) == (self.split == "test") and not is_val


@dataset_errors()
def read_frame_list(path: Path) -> frozenset[str]:
    """Read a list of frames, a row "scene/variant/number" each. Raises DatasetError."""
    rows = read_text(path).split()
    wrong = [row for row in rows if row.count("/") != 2]
    if wrong or not rows:
        raise DatasetError(
            f"{path}: {wrong[0] if wrong else 'nothing'!r} is not 'scene/variant/number', for "
            "example Scene01/clone/00000."
        )
    return frozenset(rows)


def require_every_frame(
    selection: Selection, found: Sequence[str], variants: Sequence[str], root: Path
) -> None:
    """Raise DatasetError if no frame was found, or not all that a list names.

    ``found`` are the frames taken, ``variants`` all "scene/variant" of the set.
    """
    missing = sorted(selection.frames - set(found)) if selection.frames is not None else []
    if missing:
        raise DatasetError(f"{root}: {missing[0]} is listed, but missing ({len(missing)} such).")
    if not found:
        paper = "any" if selection.split == "all" else ", ".join(PAPER_VARIANTS)
        raise DatasetError(
            f"{root}: no frames of the split {selection.split!r}. Wanted: "
            f"{', '.join(selection.scenes or [_FRAMES[selection.split]])}; variants: "
            f"{', '.join(selection.variants or [paper])}. Found: {list_names(variants)}."
        )
