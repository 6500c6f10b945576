"""Virtual KITTI 2 (Cabon et al. 2020) and 1.3.1 (Gaidon et al. 2016), and rendered scenes.

`ssdnet-render` writes its scenes in the layout of edition 2.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from runtime.io.kitti_calibration import NumbersFile
from runtime.sources.source import ListedFrame
from training.datasets.class_mapping import ClassTable
from training.datasets.files import (
    dataset_errors,
    read_points,
    read_rgb,
    require_complete,
    require_folder,
    require_size,
)
from training.datasets.sample import FrameList, Sample
from training.datasets.source_recipe import Names, SourceRecipe
from training.datasets.virtual_kitti_labels import ColorTable, read_classes, read_colors
from training.datasets.virtual_kitti_split import (
    Selection,
    Split,
    read_frame_list,
    require_every_frame,
)
from training.datasets.virtual_kitti_variant import VirtualKittiVariant, read_depth
from training.lidar.scan import project_lines
from training.limits import STRICT

_RGB_1, _DEPTH_1, _CLASSES_1 = (f"vkitti_1.3.1_{kind}" for kind in ("rgb", "depthgt", "scenegt"))
#: Of every frame of edition 1.3.1, from the set's description.
_INTRINSICS_1 = np.array([[725.0, 0.0, 620.5], [0.0, 725.0, 187.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _SelectionRecipe(SourceRecipe):
    """The keys that choose frames."""

    #: All by default, or those of the split.
    scenes: Names | None = None
    variants: Names | None = None
    #: File below ``path`` that lists the frames, rows of "scene/variant/number".
    frames: str | None = None

    @property
    def label_table(self) -> ClassTable:
        """See `SourceRecipe.label_table`."""
        return "virtual_kitti"

    def select(self, folder: Path, split: Split = "all") -> Selection:
        frames = None if self.frames is None else read_frame_list(folder / self.frames)
        return Selection(split, self.scenes, self.variants, frames)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKittiRecipe(_SelectionRecipe):
    """Options of Virtual KITTI 2 in a recipe."""

    kind: Literal["virtual-kitti"] = "virtual-kitti"
    split: Split = "train"
    #: 0 = left, 1 = right.
    cameras: Annotated[tuple[Literal[0, 1], ...], Field(min_length=1, max_length=2)] = (0,)

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        selection = self.select(folder, self.split)
        return VirtualKitti(folder, selection=selection, cameras=self.cameras, classes=classes)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedRecipe(_SelectionRecipe):
    """Options of scenes that `ssdnet-render` wrote; the folder is the split."""

    kind: Literal["rendered"] = "rendered"
    #: Feed the scans of the rendered LiDAR, with parallax and panes, instead of lines simulated
    #: from the camera's depth.
    scans: bool = False

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        selection = self.select(folder)
        return VirtualKitti(folder, selection=selection, classes=classes, scans=self.scans)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKitti1Recipe(_SelectionRecipe):
    """Options of Virtual KITTI 1.3.1, the edition of the paper's experiments."""

    kind: Literal["virtual-kitti-1"] = "virtual-kitti-1"
    split: Split = "train"

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti1":
        """See `SourceRecipe.open`."""
        return VirtualKitti1(folder, selection=self.select(folder, self.split), classes=classes)


class VirtualKitti(FrameList):
    """Frames of ``root/<scene>/<variant>/frames/{rgb,depth,classSegmentation}/Camera_<n>``.

    Args:
        root: the folder.
        selection: which frames; None: all.
        cameras: 0 = left, 1 = right.
        classes: table of the class ids.
        scans: whether the input is the rendered LiDAR's, ``frames/lidar/Camera_<n>`` and
            ``calib.txt``, with its scan lines.

    Raises:
        DatasetError: for missing folders, files without their partners, unknown colours and wrong
            sizes.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        selection: Selection | None = None,
        cameras: Sequence[int] = (0,),
        classes: ClassTable = "camvid",
        scans: bool = False,
    ) -> None:
        root = require_folder(Path(root), "scenes in the Virtual KITTI 2 layout")
        selection = selection or Selection()
        self._scans = scans
        #: From the LiDAR to the camera, of each variant.
        self._extrinsics: dict[Path, NDArray[np.float64]] = {}
        self._colors: dict[Path, ColorTable] = {}
        self._frames: list[tuple[Path, int, VirtualKittiVariant, ListedFrame]] = []
        variants = [variant for scene in _folders(root) for variant in _folders(scene)]
        for variant in variants:
            if selection.takes_variant(variant.parent.name, variant.name):
                for camera in cameras:
                    self._add(variant, camera, selection)
                self._colors[variant] = read_colors(variant / "colors.txt", classes)
        names = [f"{v.parent.name}/{v.name}/{listed.name}" for v, _, _, listed in self._frames]
        there = [f"{variant.parent.name}/{variant.name}" for variant in variants]
        require_every_frame(selection, names, there, root)

    @dataset_errors()
    def _add(self, variant: Path, camera: int, selection: Selection) -> None:
        reader = VirtualKittiVariant(variant, camera=camera)
        frames = [
            frame
            for frame in reader.list_frames()
            if frame.image is not None
            and selection.takes(variant.parent.name, variant.name, frame.name)
        ]
        for frame in frames:
            if int(frame.name) not in reader.calibrations:
                raise DatasetError(
                    f"{variant / 'intrinsic.txt'}: no row for frame {int(frame.name)} of camera "
                    f"{camera}."
                )
        folder = f"Camera_{camera}"
        require_complete(frames, variant / "frames" / "depth" / folder)
        labels = variant / "frames" / "classSegmentation" / folder
        files = [f"classgt_{frame.name}.png" for frame in frames]
        require_folder(labels, "classgt_*.png", files=files)
        if self._scans:
            lidar = variant / "frames" / "lidar" / folder
            files = [f"lidar_{frame.name}.bin" for frame in frames]
            require_folder(lidar, "the LiDAR's scans, which ssdnet-render writes", files=files)
            to_camera = NumbersFile(variant / "calib.txt").matrix("Tr_velo_to_cam", 3, 4)
            self._extrinsics[variant] = np.vstack([to_camera, np.eye(4)[3]])
        self._frames += [(variant, camera, reader, frame) for frame in frames]

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        variant, camera, reader, listed = self._frames[index]
        rgb, depth = read_rgb(listed.image), read_depth(listed.depth)
        size = (rgb.shape[0], rgb.shape[1])
        require_size(listed.depth, depth.shape, size)
        intrinsics = reader.calibrations[int(listed.name)].intrinsics
        frames, folder = variant / "frames", f"Camera_{camera}"
        sparse_depth = scan_line = None
        if self._scans:
            points = read_points(frames / "lidar" / folder / f"lidar_{listed.name}.bin")
            sparse_depth, scan_line = project_lines(
                points, intrinsics, self._extrinsics[variant], size
            )
        label = frames / "classSegmentation" / folder / f"classgt_{listed.name}.png"
        name = f"{variant.parent.name}/{variant.name}/{listed.name}"
        return Sample(
            rgb=rgb,
            targets={"depth": depth, "semantic": read_classes(label, self._colors[variant], size)},
            sparse_depth=sparse_depth,
            scan_line=scan_line,
            intrinsics=intrinsics,
            name=f"{name}/{camera}" if camera else name,
        )


class VirtualKitti1(FrameList):
    """Frames of ``root/vkitti_1.3.1_{rgb,depthgt,scenegt}/<scene>/<variant>/<number>.png``.

    Colours of the classes are listed in ``vkitti_1.3.1_scenegt/<scene>_<variant>_scenegt_rgb_
    encoding.txt``.

    Args:
        root: the folder.
        selection: which frames (scenes are called "0001" here); None: all.
        classes: table of the class ids.

    Raises:
        DatasetError: for missing folders, files without their partners, unknown colours and wrong
            sizes.
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
        images = require_folder(self._root / _RGB_1, "Virtual KITTI 1.3.1's images")
        require_folder(self._root / _DEPTH_1, "its depth maps")
        labels = require_folder(self._root / _CLASSES_1, "its class images")
        self._frames: list[tuple[str, str, str]] = []
        self._colors: dict[tuple[str, str], ColorTable] = {}
        folders = sorted(path for path in images.glob("*/*") if path.is_dir())
        for folder in folders:
            scene, variant = folder.parent.name, folder.name
            if not selection.takes_variant(scene, variant):
                continue
            numbers = [
                number
                for number in sorted(path.stem for path in folder.glob("*.png"))
                if selection.takes(scene, variant, number)
            ]
            for kind in (_DEPTH_1, _CLASSES_1):
                other, files = self._root / kind / scene / variant, [f"{n}.png" for n in numbers]
                require_folder(other, f"{kind}'s frames", files=files)
            colors = labels / f"{scene}_{variant}_scenegt_rgb_encoding.txt"
            self._colors[scene, variant] = read_colors(colors, classes)
            self._frames += [(scene, variant, number) for number in numbers]
        names = ["/".join(frame) for frame in self._frames]
        there = [f"{folder.parent.name}/{folder.name}" for folder in folders]
        require_every_frame(selection, names, there, images)

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        scene, variant, number = self._frames[index]
        file = Path(scene) / variant / f"{number}.png"
        rgb, depth = read_rgb(self._root / _RGB_1 / file), read_depth(self._root / _DEPTH_1 / file)
        size = (rgb.shape[0], rgb.shape[1])
        require_size(self._root / _DEPTH_1 / file, depth.shape, size)
        colors = self._colors[scene, variant]
        return Sample(
            rgb=rgb,
            targets={
                "depth": depth,
                "semantic": read_classes(self._root / _CLASSES_1 / file, colors, size),
            },
            intrinsics=_INTRINSICS_1,
            name=f"{scene}/{variant}/{number}",
        )


def _folders(path: Path) -> list[Path]:
    """Sorted folders, without hidden folders, which are still being rendered."""
    return sorted(p for p in path.iterdir() if p.is_dir() and not p.name.startswith("."))
