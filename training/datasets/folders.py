"""A user's images, depth and labels: a folder each, files paired by their stem."""

import json
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
    read_depth,
    read_gray,
    require_folder,
    require_size,
)
from training.datasets.sample import IGNORE, FrameList, Sample, nothing_known
from training.datasets.source_recipe import RangeRecipe
from training.lidar.scan import elevation_bands
from training.limits import STRICT, Positive, Share

#: Photos whose EXIF orientation is looked at, about.
_ORIENTED = 20
#: Warnings of this process, which opens one folder several times.
_reported: set[str] = set()

_Folder = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FoldersRecipe(RangeRecipe):
    """Options of a user's data in a recipe; folders are relative to `path`."""

    unit_key: ClassVar[str] = "depth_scale"

    kind: Literal["folders"] = "folders"
    #: 8-bit PNG or JPEG images.
    rgb: _Folder = "images"
    #: 16-bit PNGs, the depth target.
    depth: _Folder | None = None
    #: 16-bit PNGs, a recorded input in addition to that target.
    sparse_depth: _Folder | None = None
    #: The depth is a LiDAR's: a part of the returns is the input, the others are the target.
    scan: bool = False
    #: PNGs of ids in `model.classes`, or of `label_classes`, see `read_gray`.
    labels: _Folder | None = None
    #: "cityscapes": trainIds, which are mapped to `model.classes`.
    label_classes: Literal["cityscapes"] | None = None
    #: Name in `model.classes` of each id, or "ignore"; instead of the order of the classes.
    label_ids: Mapping[Annotated[int, Field(ge=0, le=255)], str] | None = None
    #: "skip-target": a frame without its depth or labels has no such target, one without its
    #: sparse depth no LiDAR. Otherwise it is an error.
    missing: Literal["error", "skip-target"] = "error"
    #: Units of the 16-bit PNGs per metre; 0 = no measurement.
    depth_scale: Positive = KITTI_DEPTH_SCALE
    #: The id of pixels without a class.
    ignore: Annotated[int, Field(ge=0, le=255)] = IGNORE
    #: fx, fy, cx, cy of every image [px]; without them no LiDAR lines are simulated.
    intrinsics: tuple[Positive, Positive, float, float] | None = None
    #: Weight of the labels, below 1 for those made by a network.
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

    An image a.jpg has its depth in a.png of the depth folder, and so on; every folder that the
    recipe names must have a file for every image, with `missing = "skip-target"` for one.

    Raises:
        DatasetError: for missing folders or partners, files of another kind or size, and ids that
            the class table does not have.
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
        #: Key of the recipe -> stem -> file of that name, whatever the case of its suffix.
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

        Sets of one folder that differ in `first` and `last` say it once.
        """
        recipe = self._recipe
        folder = self._root / recipe.rgb
        others = Counter(
            path.suffix.lower()
            for path in list_entries(folder)
            if path.suffix.lower() not in RGB_SUFFIXES and path.is_file()
        )
        texts = []
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
            turned = find_orientations(self.images[::step])
            for path, orientation in list(turned.items())[:1]:
                texts.append(
                    f"{path}: has the EXIF orientation {orientation}, like {len(turned)} of "
                    f"{len(self.images[::step])} images; pixels are used as they are stored, so "
                    "labels and depth must be stored like them: turn the pixels of photos that "
                    "were labelled upright, or remove the tag"
                )
        for text in texts:
            if text not in _reported:
                _reported.add(text)
                tqdm.write(f"warning: {text}", file=sys.stderr)

    def _require_files(self, folder: Path, lacking: Sequence[str]) -> None:
        """Raise DatasetError for images without a file, or say how many there are if they may be.

        A folder without the file of any image is an error.
        """
        if not lacking:
            return
        count = len(self._frames)
        text = f"{folder}: has no file of the frame {lacking[0]} ({len(lacking)} of {count} frames"
        text += " lack it)"
        if len(lacking) == count or self._recipe.missing == "error":
            raise DatasetError(
                f"{text}. Add the files, or leave the folder out. Where single files are missing, "
                'missing = "skip-target" leaves out the target of their frames.'
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
                # Ids that no key names may still be those of the order.
                known |= {id_: names.get(id_, "ignore") for id_ in unknown}
                pairs = ", ".join(f"{id_} = {json.dumps(name)}" for id_, name in known.items())
                advice = f"name the ids in the recipe: label_ids = {{ {pairs} }}"
            raise DatasetError(
                f"{path}: class id {unknown[-1]}, expected {', '.join(map(str, self._ids))}. "
                f"Correct the file, or {advice}."
            )
        classes: NDArray[np.uint8] = self._lookup[label]
        return classes


def _label_ids(recipe: FoldersRecipe, classes: ClassTable) -> dict[int, int]:
    """Return id in the files -> id in the class table, `IGNORE` for none."""
    names = [info.name for info in list_classes(classes)]
    if recipe.label_ids:
        ids = {"ignore": IGNORE, **{name: index for index, name in enumerate(names)}}
        unknown = [name for name in recipe.label_ids.values() if name not in ids]
        if unknown:
            raise DatasetError(
                f"label_ids: {unknown[0]!r} is no class of model.classes; expected one of "
                f"{', '.join(ids)}."
            )
        named = {index: ids[name] for index, name in recipe.label_ids.items()}
        return {recipe.ignore: IGNORE, **named}
    order = list(range(len(names)))
    if recipe.label_classes is not None:
        order = id_lookup(recipe.label_classes, classes, TRAIN_LABELS)[: len(TRAIN_LABELS)].tolist()
    return {**dict(enumerate(order)), recipe.ignore: IGNORE}
