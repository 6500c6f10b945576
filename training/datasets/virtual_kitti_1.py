"""Virtual KITTI 1.3.1 (Gaidon et al. 2016), the edition of the paper's experiments."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from training.datasets.class_mapping import ClassTable
from training.datasets.image_files import read_rgb, require_folder
from training.datasets.sample import Sample
from training.datasets.source import Names, SourceRecipe
from training.datasets.virtual_kitti import read_centimetres, require_partners
from training.datasets.virtual_kitti_labels import ColorTable, read_classes, read_colors
from training.datasets.virtual_kitti_split import (
    Selection,
    Split,
    read_frame_list,
    require_every_frame,
)
from training.limits import STRICT

_RGB, _DEPTH, _CLASSES = "vkitti_1.3.1_rgb", "vkitti_1.3.1_depthgt", "vkitti_1.3.1_scenegt"
#: Of every frame, from the set's description.
_INTRINSICS = np.array([[725.0, 0.0, 620.5], [0.0, 725.0, 187.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKitti1Recipe(SourceRecipe):
    """What a recipe says about Virtual KITTI 1.3.1."""

    kind: Literal["virtual_kitti_1"] = "virtual_kitti_1"
    split: Split = "train"
    #: Instead of the split's own.
    scenes: Names | None = None
    variants: Names | None = None
    #: File below ``path`` that lists the frames, rows of "scene/variant/number".
    frames: str | None = None

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti1":
        """See `SourceRecipe.open`."""
        frames = None if self.frames is None else read_frame_list(folder / self.frames)
        selection = Selection(self.split, self.scenes, self.variants, frames)
        return VirtualKitti1(folder, selection=selection, classes=classes)


class VirtualKitti1:
    """Frames of ``root/vkitti_1.3.1_{rgb,depthgt,scenegt}/<scene>/<variant>/<number>.png``.

    Colours of the classes are listed in ``vkitti_1.3.1_scenegt/<scene>_<variant>_scenegt_rgb_
    encoding.txt``. ``selection`` says which frames (scenes are called "0001" here), ``classes`` the
    class table. Depth is metres, 0 for the sky. Raises DatasetError for missing folders, files
    without their partners, unknown colours and wrong sizes.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        selection: Selection | None = None,
        classes: ClassTable = "camvid",
    ) -> None:
        self._root = Path(root)
        selection = selection or Selection()
        images = require_folder(self._root / _RGB, "Virtual KITTI 1.3.1's images")
        require_folder(self._root / _DEPTH, "its depth maps")
        labels = require_folder(self._root / _CLASSES, "its class pictures")
        self._frames: list[tuple[str, str, str]] = []
        self._colors: dict[tuple[str, str], ColorTable] = {}
        for folder in sorted(path for path in images.glob("*/*") if path.is_dir()):
            scene, variant = folder.parent.name, folder.name
            if not selection.takes_variant(scene, variant):
                continue
            numbers = [
                number
                for number in sorted(path.stem for path in folder.glob("*.png"))
                if selection.takes(scene, variant, number)
            ]
            for kind in (_DEPTH, _CLASSES):
                other = require_folder(self._root / kind / scene / variant, f"{kind}'s frames")
                require_partners(other, [f"{number}.png" for number in numbers])
            colors = labels / f"{scene}_{variant}_scenegt_rgb_encoding.txt"
            self._colors[scene, variant] = read_colors(colors, classes)
            self._frames += [(scene, variant, number) for number in numbers]
        require_every_frame(selection, ["/".join(frame) for frame in self._frames], images)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sample:
        scene, variant, number = self._frames[index]
        file = Path(scene) / variant / f"{number}.png"
        rgb = read_rgb(self._root / _RGB / file)
        size = (rgb.shape[0], rgb.shape[1])
        depth = read_centimetres(self._root / _DEPTH / file, size)
        return Sample(
            rgb=rgb,
            depth=depth,
            semantic=read_classes(self._root / _CLASSES / file, self._colors[scene, variant], size),
            intrinsics=_INTRINSICS,
            name=f"{scene}/{variant}/{number}",
        )
