"""A user's images, depth and labels in one folder each; files are paired by their stem."""

import os
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import cache, partial
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
from runtime.recordings.listing import ListedFrame
from training.base.limits import STRICT, Positive
from training.datasets.class_mapping import ClassTable
from training.datasets.files import (
    dataset_errors,
    find_orientations,
    list_names,
    read_depth,
    require_folder,
)
from training.datasets.labels import Folder, LabelledRecipe
from training.datasets.recording import RecordedFrames, Truth, pair

# Approximate number of photos whose EXIF orientation is examined.
_ORIENTED = 20


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
    states_camera: ClassVar[bool] = True

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
            raise ValueError("scan and sparse_depth both say what the input is: set one of them")
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

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open the images of `folder/<rgb>` with depth and labels, in natural order: 9 before 10.

        An image a.jpg has its depth in a.png of the depth folder, and so on. Every folder in the
        recipe must have a file for every image or, with `missing = "skip-target"`, for at least one
        image.

        Raises:
            DatasetError: if a folder or a partner of an image is missing, or if the class table
                lacks an id.
        """
        images, lidar = folder / self.rgb, self.depth if self.scan else self.sparse_depth
        rig = Rig()
        if self.intrinsics is not None:
            fx, fy, cx, cy = self.intrinsics
            camera = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
            rig = Rig(calibration=Calibration(camera, np.eye(4)))
        scans = None if lidar is None else require_folder(folder / lidar, "a PNG for every image")
        source = FolderSource(images, rig, depth=scans, depth_scale=self.depth_scale)
        listed = source.list_frames()
        source.camera_alone = True
        frames = [frame for frame in listed if frame.image is not None]
        taken = self.take(frames, images)
        # The files of each folder by stem, whatever the case of their suffix.
        found, truth = dict[str, Mapping[str, Path]](), dict[str, Truth]()
        if self.depth is not None and not self.scan:
            found[self.depth] = _list_pngs(folder / self.depth)
            read = partial(read_depth, depth_scale=self.depth_scale)
            truth["depth"] = Truth(found[self.depth], read)
        if lidar is not None:
            found[lidar] = {frame.name: frame.depth for frame in listed if frame.depth is not None}
        if self.labels is not None:
            found[self.labels] = _list_pngs(folder / self.labels)
            truth["semantic"] = Truth(found[self.labels], self.open_labels(classes).read)
        for below, files in found.items():
            self._require_files(folder / below, taken, files)
        _report_unread(self, folder, [frame.image for frame in taken], frames, found)
        return RecordedFrames(
            pair(source, taken, folder.name, truth),
            "bands" if self.scan else "none",
            semantic_weight=self.semantic_weight,
            lacking=self.lacking_ids(classes),
            has_lidar=self.sparse_depth is not None,
        )

    def _require_files(
        self, folder: Path, frames: Sequence[ListedFrame], files: Collection[str]
    ) -> None:
        """Raise DatasetError for images without a file; report their number if that is allowed.

        A folder without a file for any image is an error.
        """
        lacking = [frame.name for frame in frames if frame.name not in files]
        if not lacking:
            return
        text = f"{folder}: has no file of the frame {lacking[0]} ({len(lacking)} of {len(frames)} "
        text += "frames lack it)"
        if any(path.suffix.lower() in (".jpg", ".jpeg") for path in list_entries(folder)):
            text += "; its JPEGs are not read, whose compression changes ids, colours and depth"
        if len(lacking) == len(frames) or self.missing == "error":
            raise DatasetError(
                f'{text}: add the files, leave the folder out, or set missing = "skip-target", '
                "which leaves out the target of the frames whose file is missing"
            )
        tqdm.write(f"warning: {text}: not a target, or no LiDAR, there", file=sys.stderr)


def _list_pngs(folder: Path) -> Mapping[str, Path]:
    require_folder(folder, "a PNG for every image")
    has_any = any(path.suffix.lower() == ".png" for path in list_entries(folder))
    return list_files(folder, (".png",)) if has_any else {}


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in RGB_SUFFIXES


def _report_unread(
    recipe: FoldersRecipe,
    root: Path,
    taken: Sequence[Path],
    frames: Sequence[ListedFrame],
    files: Mapping[str, Mapping[str, Path]],
) -> None:
    """Warn about images of other types, files without an image, and turned photos.

    Sets in the same folder that only differ in `first` and `last` give the warning once.
    """
    folder = root / recipe.rgb
    own = [(root / name).resolve() for name in recipe.named]
    inner, others = [], Counter[str]()
    for path in list_entries(folder):
        if path.is_dir() and path.resolve() not in own:
            inner += [path.name] if any(map(_is_picture, list_entries(path))) else []
        elif path.is_file() and not _is_picture(path):
            others[path.suffix.lower()] += 1
    if inner:
        _warn(f"{folder}: images in {list_names(inner)} are not read: move them up")
    if others:
        kinds = ", ".join(
            f"{number} {kind or 'without a suffix'}" for kind, number in others.items()
        )
        _warn(f"{folder}: files that are no PNG or JPEG are not read ({kinds}): convert images")
    for below, found in files.items():
        if names := found.keys() - {frame.name for frame in frames}:
            _warn(
                f"{root / below}: {len(names)} files have no image of their name and are not used, "
                f"such as {in_natural_order(names)[0]}"
            )
    step = max(1, len(taken) // _ORIENTED)
    if recipe.labels or recipe.depth:
        labels = list(files.get(recipe.labels or "", {}).values())
        examined = [*taken[::step], *labels[::step]]
        turned = find_orientations(examined)
        for path, orientation in list(turned.items())[:1]:
            _warn(
                f"{path}: has the EXIF orientation {orientation}, like {len(turned)} of "
                f"{len(examined)} files, but pixels are used as they are stored, and labels and "
                "depth must be stored like them: turn the pixels of photos that "
                "were labelled upright, or remove the tag"
            )


@cache
def _warn(text: str) -> None:
    """Give a warning once, although a process opens a folder several times."""
    tqdm.write(f"warning: {text}", file=sys.stderr)
