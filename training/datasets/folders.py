"""Pictures, depth and labels of one's own: a folder each, files paired by their stem."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable, list_classes
from training.datasets.image_files import read_gray, read_rgb, require_folder, require_size
from training.datasets.sample import IGNORE, Sample, nothing_known
from training.datasets.source import SourceRecipe
from training.datasets.virtual_kitti import require_partners
from training.limits import STRICT, Positive, Share

_PICTURES = frozenset({".png", ".jpg", ".jpeg"})
_Folder = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FoldersRecipe(SourceRecipe):
    """What a recipe says about data of one's own; folders are relative to ``path``."""

    kind: Literal["folders"] = "folders"
    #: 8-bit PNG or JPEG pictures.
    rgb: _Folder = "images"
    #: 16-bit PNGs, the depth target.
    depth: _Folder | None = None
    #: 16-bit PNGs, a recorded input beside that target.
    sparse_depth: _Folder | None = None
    #: 8-bit one-channel PNGs of ids in ``model.classes``.
    labels: _Folder | None = None
    #: Units of the 16-bit PNGs that make a metre; 0 = no measurement.
    depth_scale: Positive = 256.0
    #: The id of pixels without a class.
    ignore: Annotated[int, Field(ge=0, le=255)] = IGNORE
    #: fx, fy, cx, cy of every picture [px]; without them no LiDAR lines are drawn.
    intrinsics: tuple[Positive, Positive, float, float] | None = None
    #: How much the labels count, below 1 for those made by a network.
    semantic_weight: Share = 1.0

    def open(self, folder: Path, classes: ClassTable) -> "Folders":
        """See `SourceRecipe.open`."""
        return Folders(folder, self, classes)


class Folders:
    """The pictures of ``root/<recipe.rgb>`` in the order of their names, with what lies beside.

    A picture a.jpg has its depth in a.png of the depth folder, and so on; every folder that the
    recipe names must have a file for every picture. Raises DatasetError for missing folders or
    partners, files of another kind or size, and ids that the class table does not have.
    """

    def __init__(self, root: Path | str, recipe: FoldersRecipe, classes: ClassTable) -> None:
        self._root, self._recipe = Path(root), recipe
        self._num_classes = len(list_classes(classes))
        pictures = require_folder(self._root / recipe.rgb, "PNG or JPEG pictures")
        self._pictures = sorted(p for p in pictures.iterdir() if p.suffix.lower() in _PICTURES)
        if not self._pictures:
            raise DatasetError(f"{pictures}: no .png, .jpg or .jpeg pictures in it.")
        stems = [path.stem for path in self._pictures]
        twice = next((a for a, b in pairwise(sorted(stems)) if a == b), None)
        if twice is not None:
            raise DatasetError(f"{pictures}: has two pictures named {twice!r}. Keep one.")
        for name in (recipe.depth, recipe.sparse_depth, recipe.labels):
            if name is not None:
                folder = require_folder(self._root / name, "a PNG a picture")
                require_partners(folder, [f"{stem}.png" for stem in stems])

    def __len__(self) -> int:
        return len(self._pictures)

    def __getitem__(self, index: int) -> Sample:
        picture = self._pictures[index]
        rgb = read_rgb(picture)
        size = (rgb.shape[0], rgb.shape[1])
        recipe = self._recipe
        intrinsics = None
        if recipe.intrinsics is not None:
            fx, fy, cx, cy = recipe.intrinsics
            intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
        depth = self._read_depth(recipe.depth, picture.stem, size)
        return Sample(
            rgb=rgb,
            depth=nothing_known(size) if depth is None else depth,
            semantic=self._read_labels(picture.stem, size),
            intrinsics=intrinsics,
            name=f"{self._root.name}/{picture.stem}",
            sparse_depth=self._read_depth(recipe.sparse_depth, picture.stem, size),
            semantic_weight=recipe.semantic_weight,
        )

    def _read_depth(
        self, folder: str | None, stem: str, size: tuple[int, int]
    ) -> NDArray[np.float32] | None:
        if folder is None:
            return None
        path = self._root / folder / f"{stem}.png"
        stored = read_gray(path, np.uint16)
        require_size(path, stored.shape, size)
        depth: NDArray[np.float32] = stored.astype(np.float32) / np.float32(
            self._recipe.depth_scale
        )
        return depth

    def _read_labels(self, stem: str, size: tuple[int, int]) -> NDArray[np.uint8]:
        if self._recipe.labels is None:
            return np.full(size, IGNORE, dtype=np.uint8)
        path = self._root / self._recipe.labels / f"{stem}.png"
        label = read_gray(path, np.uint8)
        require_size(path, label.shape, size)
        known = label != self._recipe.ignore
        highest = int(label.max(initial=0, where=known))
        if highest >= self._num_classes:
            raise DatasetError(
                f"{path}: class id {highest}, expected 0..{self._num_classes - 1} of the recipe's "
                f"model.classes, or {self._recipe.ignore} for none. Correct the file or the table."
            )
        return np.where(known, label, np.uint8(IGNORE))
