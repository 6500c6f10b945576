"""Cityscapes (Cordts et al. 2016): fine labels, and depth from its stereo disparity."""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.errors import DatasetError
from runtime.read_input import read_text
from training.datasets.class_mapping import ClassTable, id_lookup
from training.datasets.files import dataset_errors, read_gray, read_rgb, require_folder
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT

#: The classes by their trainIds 0..18.
TRAIN_LABELS: tuple[str | None, ...] = tuple(info.name for info in CLASS_TABLES["cityscapes"])
#: The labelId of each of them; the others of 0..33 are ignored.
_LABEL_IDS = (7, 8, 11, 12, 13, 17, *range(19, 29), 31, 32, 33)
#: The classes by their labelIds.
_LABELS = tuple(dict(zip(_LABEL_IDS, TRAIN_LABELS, strict=True)).get(id_) for id_ in range(34))

_IMAGE = "_leftImg8bit.png"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CityscapesRecipe(SourceRecipe):
    """Options of Cityscapes in a recipe."""

    kind: Literal["cityscapes"] = "cityscapes"
    #: train, val or test.
    split: str = "train"

    @property
    def label_table(self) -> ClassTable:
        """See `SourceRecipe.label_table`."""
        return "cityscapes"

    def open(self, folder: Path, classes: ClassTable) -> "Cityscapes":
        """See `SourceRecipe.open`."""
        return Cityscapes(folder, self, classes)


class Cityscapes(FrameList):
    """Frames of ``root/leftImg8bit/<split>/<city>/<frame>_leftImg8bit.png``.

    Labels are those of ``gtFine`` (``_gtFine_labelIds.png``). With the folders ``disparity`` and
    ``camera`` depth is baseline * fx / d with the disparity d = (p - 1) / 256 px of a 16-bit pixel
    p > 0; without them it is unknown.

    Raises:
        DatasetError: for missing folders or partners, unknown ids, wrong sizes and incomplete
            camera files.
    """

    def __init__(self, root: Path, recipe: CityscapesRecipe, classes: ClassTable) -> None:
        self._root, self._split = root, recipe.split
        images = require_folder(
            root / "leftImg8bit" / self._split, "Cityscapes' images, one folder per city"
        )
        self._lookup = id_lookup("cityscapes", classes, _LABELS)
        self._with_depth = (self._root / "disparity").is_dir()
        self._frames: list[tuple[str, str]] = []
        for city in sorted(path for path in images.iterdir() if path.is_dir()):
            stems = sorted(p.name.removesuffix(_IMAGE) for p in city.glob(f"*{_IMAGE}"))
            partners = {"gtFine": "_gtFine_labelIds.png"}
            if self._with_depth:
                partners |= {"disparity": "_disparity.png", "camera": "_camera.json"}
            for kind, suffix in partners.items():
                folder = root / kind / self._split / city.name
                require_folder(folder, f"{kind}'s files", files=[s + suffix for s in stems])
            self._frames += [(city.name, stem) for stem in stems]
        if not self._frames:
            raise DatasetError(f"{images}: no <city>/*{_IMAGE} in it.")
        self.images = [images / city / f"{stem}{_IMAGE}" for city, stem in self._frames]

    def __getitem__(self, index: int) -> Sample:
        city, stem = self._frames[index]
        rgb = read_rgb(self._path("leftImg8bit", city, stem + _IMAGE))
        size = (rgb.shape[0], rgb.shape[1])
        path = self._path("gtFine", city, stem + "_gtFine_labelIds.png")
        targets: dict[str, NDArray[Any]] = {"semantic": self._read_labels(path, size)}
        intrinsics = focal_baseline = None
        if self._with_depth:
            intrinsics, focal_baseline = _read_camera(
                self._path("camera", city, stem + "_camera.json")
            )
            path = self._path("disparity", city, stem + "_disparity.png")
            stored = read_gray(path, np.uint16, size)
            targets["depth"] = disparity_to_depth(stored, focal_baseline)
        return Sample(
            rgb=rgb,
            targets=targets,
            intrinsics=intrinsics,
            name=f"cityscapes/{self._split}/{stem}",
            focal_baseline_px_m=focal_baseline,
        )

    def _path(self, kind: str, city: str, name: str) -> Path:
        return self._root / kind / self._split / city / name

    def _read_labels(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        label = read_gray(path, np.uint8, size)
        if label.max() >= len(_LABELS):
            raise DatasetError(
                f"{path}: label id {label.max()}, expected 0..{len(_LABELS) - 1} of labelIds. "
                "Give the original *_labelIds.png, not trainIds."
            )
        ids: NDArray[np.uint8] = self._lookup[label]
        return ids


def disparity_to_depth(
    stored: NDArray[np.uint16], focal_baseline: float, *, zero: int = 1
) -> NDArray[np.float32]:
    """Convert a disparity image of Cityscapes, or of another ``zero``, to depth.

    Args:
        stored: uint16 (H, W); p > 0 means d = (p - zero) / 256 px. A disparity of 0 is at infinity
            and counts as none.
        focal_baseline: fx * baseline [px m].
        zero: the value of a disparity of 0.

    Returns:
        float32 (H, W), metres, 0 = none.
    """
    disparity = (stored.astype(np.float32) - zero) / 256.0
    depth = np.zeros(stored.shape, dtype=np.float32)
    np.divide(np.float32(focal_baseline), disparity, out=depth, where=disparity > 0)
    return depth


@dataset_errors()
def _read_camera(path: Path) -> tuple[NDArray[np.float64], float]:
    """K (3, 3) and fx * baseline (px m) of a camera file."""
    try:
        document = json.loads(read_text(path))
        camera, baseline = document["intrinsic"], float(document["extrinsic"]["baseline"])
        fx, fy, u0, v0 = (float(camera[key]) for key in ("fx", "fy", "u0", "v0"))
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: expected JSON with intrinsic fx, fy, u0, v0 and extrinsic baseline "
            f"({type(error).__name__}: {error}). Restore the original file."
        ) from error
    if not (baseline > 0 and fx > 0 and fy > 0):
        raise DatasetError(f"{path}: baseline {baseline}, fx {fx}, fy {fy}; all must be positive.")
    return np.array([[fx, 0, u0], [0, fy, v0], [0, 0, 1]], np.float64), fx * baseline
