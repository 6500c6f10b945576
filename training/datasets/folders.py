"""A user's images, depth and labels: a folder each, files paired by their stem."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from runtime.io.images import KITTI_DEPTH_SCALE
from runtime.sources.folders import FolderSource
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup, list_classes
from training.datasets.files import (
    dataset_errors,
    read_depth,
    read_gray,
    require_complete,
    require_folder,
    require_size,
)
from training.datasets.sample import IGNORE, FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT, Positive, Share

_Folder = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FoldersRecipe(SourceRecipe):
    """Options of a user's data in a recipe; folders are relative to ``path``."""

    kind: Literal["folders"] = "folders"
    #: 8-bit PNG or JPEG images.
    rgb: _Folder = "images"
    #: 16-bit PNGs, the depth target.
    depth: _Folder | None = None
    #: 16-bit PNGs, a recorded input in addition to that target.
    sparse_depth: _Folder | None = None
    #: 8-bit one-channel PNGs of ids in ``model.classes``, or of ``label_classes``.
    labels: _Folder | None = None
    #: "cityscapes": trainIds, which are mapped to ``model.classes``.
    label_classes: Literal["cityscapes"] | None = None
    #: Units of the 16-bit PNGs per metre; 0 = no measurement.
    depth_scale: Positive = KITTI_DEPTH_SCALE
    #: The id of pixels without a class.
    ignore: Annotated[int, Field(ge=0, le=255)] = IGNORE
    #: fx, fy, cx, cy of every image [px]; without them no LiDAR lines are simulated.
    intrinsics: tuple[Positive, Positive, float, float] | None = None
    #: Weight of the labels, below 1 for those made by a network.
    semantic_weight: Share = 1.0

    def open(self, folder: Path, classes: ClassTable) -> "Folders":
        """See `SourceRecipe.open`."""
        return Folders(folder, self, classes)


class Folders(FrameList):
    """The images of ``root/<recipe.rgb>`` in the order of their names, with depth and labels.

    An image a.jpg has its depth in a.png of the depth folder, and so on; every folder that the
    recipe names must have a file for every image.

    Raises:
        DatasetError: for missing folders or partners, files of another kind or size, and ids that
            the class table does not have.
    """

    @dataset_errors()
    def __init__(self, root: Path | str, recipe: FoldersRecipe, classes: ClassTable) -> None:
        self._root, self._recipe = Path(root), recipe
        self._num_classes = len(list_classes(recipe.label_classes or classes))
        self._lookup = np.arange(256, dtype=np.uint8)
        if recipe.label_classes is not None:
            self._lookup = id_lookup(recipe.label_classes, classes, TRAIN_LABELS)
        depth = None if recipe.depth is None else self._root / recipe.depth
        self._source = FolderSource(
            self._root / recipe.rgb, depth=depth, depth_scale=recipe.depth_scale
        )
        images = [frame for frame in self._source.list_frames() if frame.image is not None]
        self._frames = sorted(images, key=lambda frame: str(frame.image))
        if depth is not None:
            require_complete(self._frames, depth)
        for name in (recipe.sparse_depth, recipe.labels):
            if name is not None:
                files = [f"{frame.name}.png" for frame in self._frames]
                require_folder(self._root / name, "a PNG for every image", files=files)

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
            path = self._root / recipe.sparse_depth / f"{listed.name}.png"
            sparse_depth = read_depth(path, size, depth_scale=recipe.depth_scale)
        targets: dict[str, NDArray[Any]] = {}
        if recipe.depth is not None:
            targets["depth"] = frame.sparse_depth
        if recipe.labels is not None:
            path = self._root / recipe.labels / f"{listed.name}.png"
            targets["semantic"] = self._read_labels(path, size)
        return Sample(
            rgb=frame.rgb,
            targets=targets,
            intrinsics=intrinsics,
            name=f"{self._root.name}/{listed.name}",
            sparse_depth=sparse_depth,
            weights={"semantic": recipe.semantic_weight},
        )

    def _read_labels(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        label = read_gray(path, np.uint8, size)
        known = label != self._recipe.ignore
        highest = int(label.max(initial=0, where=known))
        if highest >= self._num_classes:
            table = self._recipe.label_classes or "the recipe's model.classes"
            raise DatasetError(
                f"{path}: class id {highest}, expected 0..{self._num_classes - 1} of {table}, or "
                f"{self._recipe.ignore} for none. Correct the file or the table."
            )
        return np.where(known, self._lookup[label], np.uint8(IGNORE))
