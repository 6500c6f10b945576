"""A user's images, depth and labels in one folder each; files are paired by their stem."""

import os
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic.dataclasses import dataclass
from tqdm import tqdm

from runtime.base.errors import DatasetError
from runtime.base.natural_order import in_natural_order
from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource, list_entries
from runtime.recordings.images import KITTI_DEPTH_SCALE, RGB_SUFFIXES, list_files
from runtime.recordings.source import ListedFrame
from training.datasets.class_mapping import ClassTable
from training.datasets.files import (
    dataset_errors,
    find_orientations,
    list_names,
    read_depth,
    require_folder,
)
from training.datasets.labels import Folder, LabelledRecipe, LabelReader
from training.datasets.recording import RecordedFrames, Targets
from training.datasets.sample import Sample, nothing_known
from training.limits import STRICT, Positive

# Approximate number of photos whose EXIF orientation is examined.
_ORIENTED = 20
# Warnings that this process has already given, because it opens a folder several times.
_reported: set[str] = set()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FoldersRecipe(LabelledRecipe):
    """Options of a user's data in a recipe; folders are relative to `path`.

    Attributes:
        rgb: folder of 8-bit PNG or JPEG images.
        depth: folder of 16-bit PNGs, the depth target.
        sparse_depth: folder of 16-bit PNGs, an input that was recorded in addition to the target.
        scan: whether the depth is a LiDAR's: a part of its returns is the input, the others are the
            target.
        missing: with "skip-target", a frame whose depth or labels are missing has no such target,
            and a frame without sparse depth has no LiDAR. Otherwise a missing file is an error.
        depth_scale: units of the 16-bit PNGs per metre; 0 = no measurement.
        intrinsics: fx, fy, cx, cy of every image [px]; without them no LiDAR lines are simulated.
    """

    unit_key: ClassVar[str] = "depth_scale"

    kind: Literal["folders"] = "folders"
    rgb: Folder = "images"
    depth: Folder | None = None
    sparse_depth: Folder | None = None
    scan: bool = False
    missing: Literal["error", "skip-target"] = "error"
    depth_scale: Positive = KITTI_DEPTH_SCALE
    intrinsics: tuple[Positive, Positive, float, float] | None = None

    def __post_init__(self) -> None:
        """Check that the ids have one meaning, and the returns one use."""
        if self.scan and self.sparse_depth is not None:
            raise ValueError("scan and sparse_depth both say what the input is; set one of them")
        super().__post_init__()

    @property
    def folders(self) -> tuple[str, ...]:
        """See `SourceRecipe.folders`."""
        outside = [name for name in self.named if name.startswith("..") or os.path.isabs(name)]
        return self.path, *(os.path.normpath(os.path.join(self.path, name)) for name in outside)

    @property
    def named(self) -> list[str]:
        """The folders of a frame's files, relative to `path`."""
        return [n for n in (self.rgb, self.depth, self.sparse_depth, self.labels) if n is not None]

    def open(self, folder: Path, classes: ClassTable) -> "Folders":
        """See `SourceRecipe.open`."""
        return Folders(folder, self, classes)


class Folders(RecordedFrames):
    """The images of `root/<recipe.rgb>` with depth and labels, in natural order: 9 before 10.

    An image a.jpg has its depth in a.png of the depth folder, and so on. Every folder in the recipe
    must have a file for every image or, with `missing = "skip-target"`, for at least one image.

    Raises:
        DatasetError: if a folder or a partner of an image is missing, if a file has another kind or
            size, or if the class table lacks an id.
    """

    @dataset_errors()
    def __init__(self, root: Path, recipe: FoldersRecipe, classes: ClassTable) -> None:
        self._root, self._recipe = root, recipe
        self._labels = LabelReader(recipe, classes)
        depth = None if recipe.depth is None else self._root / recipe.depth
        rig = Rig()
        if recipe.intrinsics is not None:
            fx, fy, cx, cy = recipe.intrinsics
            camera = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
            rig = Rig(calibration=Calibration(camera, np.eye(4)))
        source = FolderSource(
            self._root / recipe.rgb, rig, depth=depth, depth_scale=recipe.depth_scale
        )
        listed = source.list_frames()
        source.camera_alone = recipe.missing == "skip-target"
        taken = recipe.take(
            [frame for frame in listed if frame.image is not None], self._root / recipe.rgb
        )
        super().__init__(
            [(source, frame, f"{root.name}/{frame.name}") for frame in taken],
            "bands" if recipe.scan else "none",
            {"semantic": recipe.semantic_weight},
        )
        if depth is not None:
            self._require_files(depth, [frame.name for frame in taken if not frame.depth])
        every = {frame.name for frame in listed if frame.image is not None}
        unpaired = {"depth": {frame.name for frame in listed} - every}
        # For each key of the recipe: the files by stem, whatever the case of their suffix.
        self._files: dict[str, dict[str, Path]] = {}
        for key, below in (("sparse_depth", recipe.sparse_depth), ("labels", recipe.labels)):
            if below is None:
                continue
            folder = require_folder(self._root / below, "a PNG for every image")
            has_any = any(path.suffix.lower() == ".png" for path in list_entries(folder))
            self._files[key] = list_files(folder, (".png",)) if has_any else {}
            unpaired[key] = self._files[key].keys() - every
            lacking = [frame.name for frame in taken if frame.name not in self._files[key]]
            self._require_files(folder, lacking)
        self._report_unread(unpaired)

    def _report_unread(self, unpaired: Mapping[str, Collection[str]]) -> None:
        """Warn about images of other types, files without an image, and turned photos.

        Sets in the same folder that only differ in `first` and `last` give the warning once.
        """
        recipe = self._recipe
        folder = self._root / recipe.rgb
        own = [(self._root / name).resolve() for name in recipe.named]
        below = [
            path.name
            for path in list_entries(folder)
            if path.is_dir()
            and path.resolve() not in own
            and any(each.suffix.lower() in RGB_SUFFIXES for each in list_entries(path))
        ]
        others = Counter(
            path.suffix.lower()
            for path in list_entries(folder)
            if path.suffix.lower() not in RGB_SUFFIXES and path.is_file()
        )
        texts = []
        if below:
            texts.append(f"{folder}: images in {list_names(below)} are not read; move them up")
        if others:
            kinds = ", ".join(
                f"{number} {kind or 'without a suffix'}" for kind, number in others.items()
            )
            texts.append(
                f"{folder}: files that are no PNG or JPEG are not read ({kinds}); convert images"
            )
        for key, names in unpaired.items():
            if names:
                first = in_natural_order(names)[0]
                texts.append(
                    f"{self._root / str(getattr(recipe, key))}: {len(names)} files have no image "
                    f"of their name and are not used, such as {first}"
                )
        step = max(1, len(self.images) // _ORIENTED)
        if recipe.labels or recipe.depth:
            labels = list(self._files.get("labels", {}).values())
            examined = [*self.images[::step], *labels[::step]]
            turned = find_orientations(examined)
            for path, orientation in list(turned.items())[:1]:
                texts.append(
                    f"{path}: has the EXIF orientation {orientation}, like {len(turned)} of "
                    f"{len(examined)} files; pixels are used as they are stored, so "
                    "labels and depth must be stored like them: turn the pixels of photos that "
                    "were labelled upright, or remove the tag"
                )
        for text in texts:
            if text not in _reported:
                _reported.add(text)
                tqdm.write(f"warning: {text}", file=sys.stderr)

    def _require_files(self, folder: Path, lacking: Sequence[str]) -> None:
        """Raise DatasetError for images without a file; report their number if that is allowed.

        A folder without a file for any image is an error.
        """
        if not lacking:
            return
        count = len(self._frames)
        text = f"{folder}: has no file of the frame {lacking[0]} ({len(lacking)} of {count} frames"
        text += " lack it)"
        if len(lacking) == count or self._recipe.missing == "error":
            raise DatasetError(
                f"{text}: add the files, or leave the folder out; where single files are missing, "
                'missing = "skip-target" leaves out the target of their frames'
            )
        tqdm.write(f"warning: {text}: not a target, or no LiDAR, there", file=sys.stderr)

    def _read_truth(self, listed: ListedFrame, size: tuple[int, int]) -> Targets:
        path = self._files.get("labels", {}).get(listed.name)
        return {} if path is None else {"semantic": self._labels.read(path, size)}

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        sample, files = super().__getitem__(index), self._files.get("sparse_depth")
        if files is None:
            return sample
        sparse_depth, path = nothing_known(sample.size), files.get(self._frames[index][1].name)
        if path is not None:
            sparse_depth = read_depth(path, sample.size, depth_scale=self._recipe.depth_scale)
        return replace(sample, sparse_depth=sparse_depth)
