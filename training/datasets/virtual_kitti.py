"""Virtual KITTI 2 (Cabon et al. 2020) and 1.3.1 (Gaidon et al. 2016), and rendered scenes.

`ssdnet-render` writes its scenes in the layout of edition 2.
"""

import io
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.files.read_input import read_text
from runtime.geometry.calibration import Calibration
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.listing import ListedFrame
from training.base.limits import STRICT
from training.datasets.class_list import Color
from training.datasets.class_mapping import ClassTable, class_ids
from training.datasets.color_reader import ColorReader
from training.datasets.files import (
    dataset_errors,
    read_depth,
    require_files,
    require_folder,
)
from training.datasets.recording import RecordedFrames, SetFrame, Truth, pair
from training.datasets.source_recipe import Names, SourceRecipe
from training.datasets.virtual_kitti_split import Selection, Split

_RGB_1, _DEPTH_1, _CLASSES_1 = (f"vkitti_1.3.1_{kind}" for kind in ("rgb", "depthgt", "scenegt"))
# Intrinsics of every frame of edition 1.3.1, from the set's description.
_INTRINSICS_1 = np.array([[725.0, 0.0, 620.5], [0.0, 725.0, 187.0], [0.0, 0.0, 1.0]])
_UNITS_A_METRE = 100.0
_INTRINSICS_ROW = "'frame cameraID fx fy cx cy'"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _SelectionRecipe(SourceRecipe):
    """The keys that choose frames.

    Attributes:
        scenes: names of scenes and variants; None: all, or those of the split.
    """

    labelled: ClassVar[str] = "virtual_kitti"

    scenes: Names | None = None
    variants: Names | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKittiRecipe(_SelectionRecipe):
    """Options of Virtual KITTI 2 in a recipe.

    Attributes:
        cameras: numbers of the cameras: 0 = left, 1 = right.
    """

    kind: Literal["virtual-kitti"] = "virtual-kitti"
    split: Split = "train"
    cameras: Annotated[tuple[Literal[0, 1], ...], Field(min_length=1, max_length=2)] = (0,)

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        selection = Selection(self.split, self.scenes, self.variants)
        return RecordedFrames(_list_second_edition(folder, classes, selection, self.cameras))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedRecipe(_SelectionRecipe):
    """Options of scenes that `ssdnet-render` wrote; the folder is the split.

    Attributes:
        scans: feed the scans of the rendered LiDAR, with parallax and panes, instead of lines
            simulated from the camera's depth.
    """

    kind: Literal["rendered"] = "rendered"
    scans: bool = False

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        selection = Selection("all", self.scenes, self.variants)
        frames = _list_second_edition(folder, classes, selection, scans=self.scans)
        return RecordedFrames(frames, "ordered")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKitti1Recipe(_SelectionRecipe):
    """Options of Virtual KITTI 1.3.1, the edition of the paper's experiments."""

    kind: Literal["virtual-kitti-1"] = "virtual-kitti-1"
    split: Split = "train"

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        selection = Selection(self.split, self.scenes, self.variants)
        return RecordedFrames(_list_first_edition(folder, classes, selection))


_read_depth = partial(read_depth, depth_scale=_UNITS_A_METRE)


@dataset_errors()
def _list_second_edition(
    root: Path,
    classes: ClassTable,
    selection: Selection,
    cameras: Sequence[int] = (0,),
    *,
    scans: bool = False,
) -> list[SetFrame]:
    """List `root/<scene>/<variant>/frames/{rgb,depth,classSegmentation}/Camera_<n>`.

    With `scans`, `frames/lidar/Camera_<n>` and `calib.txt`, which ssdnet-render writes, are listed,
    too.
    """
    require_folder(root, "scenes in the Virtual KITTI 2 layout")
    variants = [variant for scene in _folders(root) for variant in _folders(scene)]
    frames = [
        frame
        for variant in variants
        for camera in cameras
        if selection.takes_variant(variant.parent.name, variant.name)
        for frame in _list_camera(variant, camera, classes, selection, scans=scans)
    ]
    selection.require_frames(frames, variants, root)
    return frames


def _list_camera(
    variant: Path, camera: int, classes: ClassTable, selection: Selection, *, scans: bool
) -> Iterator[SetFrame]:
    scene, kinds = variant.parent.name, ("rgb", "depth", "classSegmentation", "lidar")
    rgb, depth, labels, lidar = (variant / "frames" / k / f"Camera_{camera}" for k in kinds)
    images = sorted(require_folder(rgb, "the images").glob("rgb_*.jpg"))
    pictures = {path.stem.removeprefix("rgb_"): path for path in images}
    numbers = [n for n in pictures if n.isdecimal() and selection.takes(scene, n)]
    colors = _read_colors(variant / "colors.txt", classes)
    truth = {
        "depth": Truth(require_files(depth, "depth", numbers, "depth_{}.png"), _read_depth),
        "semantic": Truth(
            require_files(labels, "classes", numbers, "classgt_{}.png"),
            colors.read,
        ),
    }
    returns, to_camera = dict[str, Path](), np.eye(4)
    if scans:
        to_camera[:3] = NumbersFile(variant / "calib.txt").matrix("Tr_velo_to_cam", 3, 4)
        returns = require_files(lidar, "scans", numbers, "lidar_{}.bin")
    intrinsics = _read_intrinsics(variant / "intrinsic.txt", camera)
    sources: dict[bytes, FolderSource] = {}  # by the camera's matrix, of which there is mostly one
    for number in numbers:
        matrix = intrinsics.get(int(number))
        if matrix is None:
            raise DatasetError(
                f"{variant / 'intrinsic.txt'}: no row {_INTRINSICS_ROW} of frame {int(number)}, "
                f"camera {camera}: restore the file"
            )
        if (key := matrix.tobytes()) not in sources:
            rig = Rig(calibration=Calibration(matrix, to_camera))
            sources[key] = FolderSource(rgb, rig, points=lidar if scans else None)
        listed = ListedFrame(0, number, pictures[number], returns.get(number))
        for frame in pair(sources[key], [listed], f"{scene}/{variant.name}", truth):
            yield frame._replace(name=f"{frame.name}/{camera}") if camera else frame


@dataset_errors()
def _list_first_edition(root: Path, classes: ClassTable, selection: Selection) -> list[SetFrame]:
    """List `root/vkitti_1.3.1_{rgb,depthgt,scenegt}/<scene>/<variant>/<number>.png`.

    Colours are in `vkitti_1.3.1_scenegt/<scene>_<variant>_scenegt_rgb_encoding.txt`; scenes are
    called "0001".
    """
    for kind in (_RGB_1, _DEPTH_1, _CLASSES_1):
        require_folder(root / kind, "a folder of Virtual KITTI 1.3.1")
    frames: list[SetFrame] = []
    rig = Rig(calibration=Calibration(_INTRINSICS_1, np.eye(4)))
    variants = sorted(path for path in (root / _RGB_1).glob("*/*") if path.is_dir())
    for variant in variants:
        scene = variant.parent.name
        if not selection.takes_variant(scene, variant.name):
            continue
        source, place = FolderSource(variant, rig), Path(scene, variant.name)
        listed = [
            frame
            for frame in source.list_frames()
            if frame.name.isdecimal() and selection.takes(scene, frame.name)
        ]
        names = [frame.name for frame in listed]
        depth, labels = (
            require_files(root / kind / place, "its frames", names)
            for kind in (_DEPTH_1, _CLASSES_1)
        )
        file = f"{scene}_{variant.name}_scenegt_rgb_encoding.txt"
        colors = _read_colors(root / _CLASSES_1 / file, classes)
        truth = {
            "depth": Truth(depth, _read_depth),
            "semantic": Truth(labels, colors.read),
        }
        frames += pair(source, listed, str(place), truth)
    selection.require_frames(frames, variants, root / _RGB_1)
    return frames


def _folders(path: Path) -> list[Path]:
    """Return the folders in order, without hidden ones, which are still being rendered."""
    return sorted(p for p in path.iterdir() if p.is_dir() and not p.name.startswith("."))


def _read_intrinsics(path: Path, camera: int) -> dict[int, NDArray[np.float64]]:
    """Return K of each frame, from rows 'frame cameraID fx fy cx cy' under a header."""
    try:
        rows = np.loadtxt(io.StringIO(read_text(path)), skiprows=1, ndmin=2)
        number, cameras, fx, fy, cx, cy = rows.T
    except ValueError as error:
        raise DatasetError(f"{path}: expected rows {_INTRINSICS_ROW}: {error}") from error
    if not (np.isfinite(rows).all() and (rows[:, 2:4] > 0).all()):
        raise DatasetError(f"{path}: expected rows {_INTRINSICS_ROW}, finite, with fx, fy > 0")
    matrices = np.tile(np.eye(3), (len(rows), 1, 1))
    matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 0, 2], matrices[:, 1, 2] = fx, fy, cx, cy
    ours = cameras == camera
    return dict(zip(number[ours].astype(int).tolist(), matrices[ours], strict=True))


@dataset_errors()
def _read_colors(path: Path, classes: ClassTable) -> ColorReader:
    """Read the colours of a file; return the reader of labels in these colours.

    The rows are 'Category r g b' in Virtual KITTI 2, and 'Category:instance r g b' in 1.3.1.
    """
    known = class_ids("virtual_kitti", classes)
    found: dict[Color, int] = {}
    for row in filter(None, map(str.split, read_text(path).splitlines()[1:])):
        name = row[0].split(":")[0]
        if name not in known:
            raise DatasetError(f"{path}: unknown category {name!r}: give one of {', '.join(known)}")
        try:
            red, green, blue = bytes(int(value) for value in row[-3:])
        except ValueError as error:
            raise DatasetError(f"{path}: {' '.join(row)!r} is not 'Category r g b'") from error
        found[red, green, blue] = known[name]
    if not found:
        raise DatasetError(f"{path}: no rows under its header")
    return ColorReader(found, path.name, "restore the original file")
