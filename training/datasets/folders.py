"""A user's images, depth and labels in one folder each; files are paired by their stem."""

import json
import os
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from tqdm import tqdm

from runtime.base.errors import DatasetError
from runtime.base.natural_order import in_natural_order
from runtime.contract.contract import ClassInfo
from runtime.recordings.folders import FolderSource, list_entries
from runtime.recordings.images import KITTI_DEPTH_SCALE, RGB_SUFFIXES, list_files
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup, list_classes
from training.datasets.files import (
    dataset_errors,
    find_orientations,
    list_names,
    read_depth,
    read_gray,
    require_folder,
    require_size,
)
from training.datasets.sample import IGNORE, FrameList, Sample, nothing_known
from training.datasets.source_recipe import RangeRecipe
from training.lidar.scan import elevation_bands
from training.limits import STRICT, Positive, Share

# Approximate number of photos whose EXIF orientation is examined.
_ORIENTED = 20
# Warnings that this process has already given, because it opens a folder several times.
_reported: set[str] = set()

_Folder = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FoldersRecipe(RangeRecipe):
    """Options of a user's data in a recipe; folders are relative to `path`.

    Attributes:
        rgb: folder of 8-bit PNG or JPEG images.
        depth: folder of 16-bit PNGs, the depth target.
        sparse_depth: folder of 16-bit PNGs, an input that was recorded in addition to the target.
        scan: whether the depth is a LiDAR's: a part of its returns is the input, the others are the
            target.
        labels: folder of PNGs with ids in `model.classes` or in `label_classes`, see `read_gray`.
        label_classes: "cityscapes": the ids are trainIds, which are mapped to `model.classes`.
        label_ids: name in `model.classes` of each id, or "ignore"; replaces the order of the
            classes.
        missing: with "skip-target", a frame whose depth or labels are missing has no such target,
            and a frame without sparse depth has no LiDAR. Otherwise a missing file is an error.
        depth_scale: units of the 16-bit PNGs per metre; 0 = no measurement.
        ignore: id of pixels without a class.
        intrinsics: fx, fy, cx, cy of every image [px]; without them no LiDAR lines are simulated.
        semantic_weight: weight of the labels; below 1 for labels that a network made.
    """

    unit_key: ClassVar[str] = "depth_scale"

    kind: Literal["folders"] = "folders"
    rgb: _Folder = "images"
    depth: _Folder | None = None
    sparse_depth: _Folder | None = None
    scan: bool = False
    labels: _Folder | None = None
    label_classes: Literal["cityscapes"] | None = None
    label_ids: Mapping[Annotated[int, Field(ge=0, le=255)], str] | None = None
    missing: Literal["error", "skip-target"] = "error"
    depth_scale: Positive = KITTI_DEPTH_SCALE
    ignore: Annotated[int, Field(ge=0, le=255)] = IGNORE
    intrinsics: tuple[Positive, Positive, float, float] | None = None
    semantic_weight: Share = 1.0

    def __post_init__(self) -> None:
        """Check that the ids have one meaning, and the returns one use."""
        if self.scan and self.sparse_depth is not None:
            raise ValueError("scan and sparse_depth both say what the input is; set one of them")
        if self.label_ids and self.label_classes is not None:
            raise ValueError("label_ids and label_classes both name the ids; set one of them")
        if self.ignore != IGNORE and (self.label_ids or {}).get(self.ignore, "ignore") != "ignore":
            raise ValueError(
                f"ignore and label_ids give the id {self.ignore} two meanings; drop one"
            )

    @property
    def folders(self) -> tuple[str, ...]:
        """See `SourceRecipe.folders`."""
        outside = [name for name in self.named if name.startswith("..") or os.path.isabs(name)]
        return self.path, *(os.path.normpath(os.path.join(self.path, name)) for name in outside)

    @property
    def named(self) -> list[str]:
        """The folders of a frame's files, relative to `path`."""
        return [n for n in (self.rgb, self.depth, self.sparse_depth, self.labels) if n is not None]

    @property
    def label_table(self) -> ClassTable | None:
        """See `SourceRecipe.label_table`."""
        if self.labels is None:
            return ()
        named = [name for name in (self.label_ids or {}).values() if name != "ignore"]
        own = tuple(ClassInfo(name, (0, 0, 0)) for name in dict.fromkeys(named))
        return own or self.label_classes

    def open(self, folder: Path, classes: ClassTable) -> "Folders":
        """See `SourceRecipe.open`."""
        return Folders(folder, self, classes)


class Folders(FrameList):
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
        self._names = [info.name for info in list_classes(classes)]
        self._ids = _label_ids(recipe, classes)
        self._lookup = np.full(256, IGNORE, np.uint8)
        self._lookup[list(self._ids)] = list(self._ids.values())
        self._known = np.isin(np.arange(256), list(self._ids))
        depth = None if recipe.depth is None else self._root / recipe.depth
        self._source = FolderSource(
            self._root / recipe.rgb, depth=depth, depth_scale=recipe.depth_scale
        )
        listed = self._source.list_frames()
        self._frames = recipe.take(
            [frame for frame in listed if frame.image is not None], self._root / recipe.rgb
        )
        self._source.camera_alone = recipe.missing == "skip-target"
        self.images = [frame.image for frame in self._frames]
        if depth is not None:
            self._require_files(depth, [frame.name for frame in self._frames if not frame.depth])
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
            names = [frame.name for frame in self._frames]
            self._require_files(folder, [name for name in names if name not in self._files[key]])
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

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        listed, recipe = self._frames[index], self._recipe
        frame = self._source.read(listed)
        size = (frame.rgb.shape[0], frame.rgb.shape[1])
        if listed.depth is not None:
            require_size(listed.depth, frame.sparse_depth.shape, size)
        intrinsics = sparse_depth = None
        if recipe.intrinsics is not None:
            fx, fy, cx, cy = recipe.intrinsics
            intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
        if recipe.sparse_depth is not None:
            sparse_depth = nothing_known(size)
            if path := self._files["sparse_depth"].get(listed.name):
                sparse_depth = read_depth(path, size, depth_scale=recipe.depth_scale)
        scan_line = elevation_bands(frame.sparse_depth, intrinsics) if recipe.scan else None
        targets: dict[str, NDArray[Any]] = {}
        if listed.depth is not None:
            targets["depth"] = frame.sparse_depth
        if path := self._files.get("labels", {}).get(listed.name):
            targets["semantic"] = self._read_labels(path, size)
        return Sample(
            rgb=frame.rgb,
            targets=targets,
            intrinsics=intrinsics,
            name=f"{self._root.name}/{listed.name}",
            sparse_depth=sparse_depth,
            scan_line=scan_line,
            weights={"semantic": recipe.semantic_weight},
        )

    def _read_labels(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        label = read_gray(path, np.uint8, size)
        unknown = np.unique(label[~self._known[label]]).tolist()
        if unknown:
            advice = "give trainIds"
            if self._recipe.label_classes is None:
                names = dict(enumerate(self._names))
                known = {id_: names.get(index, "ignore") for id_, index in self._ids.items()}
                # Ids that no key names may still follow the order of the classes.
                known |= {id_: names.get(id_, "ignore") for id_ in unknown}
                pairs = ", ".join(f"{id_} = {json.dumps(name)}" for id_, name in known.items())
                advice = f"name the ids in the recipe: label_ids = {{ {pairs} }}"
            raise DatasetError(
                f"{path}: class id {unknown[-1]}, expected {', '.join(map(str, self._ids))}: "
                f"correct the file, or {advice}"
            )
        classes: NDArray[np.uint8] = self._lookup[label]
        return classes


def _label_ids(recipe: FoldersRecipe, classes: ClassTable) -> dict[int, int]:
    """Return the id in the class table for each id in the files, `IGNORE` for none."""
    names = [info.name for info in list_classes(classes)]
    if recipe.label_ids:
        ids = {"ignore": IGNORE, **{name: index for index, name in enumerate(names)}}
        unknown = [name for name in recipe.label_ids.values() if name not in ids]
        if unknown:
            raise DatasetError(
                f"label_ids: {unknown[0]!r} is no class of model.classes; expected one of "
                f"{', '.join(ids)}"
            )
        named = {index: ids[name] for index, name in recipe.label_ids.items()}
        return {recipe.ignore: IGNORE, **named}
    order = list(range(len(names)))
    if recipe.label_classes is not None:
        order = id_lookup(recipe.label_classes, classes, TRAIN_LABELS)[: len(TRAIN_LABELS)].tolist()
    return {**dict(enumerate(order)), recipe.ignore: IGNORE}
