"""Virtual KITTI 2 (Cabon et al. 2020) and 1.3.1 (Gaidon et al. 2016), and rendered scenes.

`ssdnet-render` writes its scenes in the layout of edition 2.
"""

import io
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
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
    list_names,
    read_depth,
    require_files,
    require_folder,
)
from training.datasets.recording import RecordedFrames, SetFrame, Truth, pair
from training.datasets.source_recipe import Names, SourceRecipe

_RGB_1, _DEPTH_1, _CLASSES_1 = (f"vkitti_1.3.1_{kind}" for kind in ("rgb", "depthgt", "scenegt"))
# Intrinsics of every frame of edition 1.3.1, from the set's description.
_INTRINSICS_1 = np.array([[725.0, 0.0, 620.5], [0.0, 725.0, 187.0], [0.0, 0.0, 1.0]])
_UNITS_A_METRE = 100.0
_INTRINSICS_ROW = "'frame cameraID fx fy cx cy'"

Split = Literal["train", "val", "test", "all"]

# The paper uses eight of the ten variants without naming them. These are the variants whose camera
# angle is closest to the recorded camera.
PAPER_VARIANTS = (
    *("15-deg-left", "15-deg-right"),
    *("clone", "fog", "morning", "overcast", "rain", "sunset"),
)
_TEST_SCENE = 1  # 447 frames per variant; 3,576 in all, as in the paper
_VAL_SCENE, _VAL_FIRST = 20, 547  # the last 290 of its 837 frames; 2,320 in all, as in the paper


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _ScenesRecipe(SourceRecipe):
    """The keys that choose frames.

    Attributes:
        scenes: names of scenes and variants; None: all, or those of the split.
    """

    labelled: ClassVar[str] = "virtual_kitti"

    scenes: Names | None = None
    variants: Names | None = None

    @property
    def part(self) -> Split:
        """The split whose frames are taken."""
        return "all"

    def takes_variant(self, scene: str, variant: str) -> bool:
        """Whether any frame of a variant of a scene may be taken."""
        if self.variants is not None:
            known = variant in self.variants
        else:
            known = self.part == "all" or variant in PAPER_VARIANTS
        return known and (self.scenes is None or scene in self.scenes)

    def takes(self, scene: str, number: str) -> bool:
        """Whether a frame belongs to the split, in a variant that belongs to it."""
        if self.part == "all" or self.scenes is not None:
            return True
        scene_number = int("".join(filter(str.isdigit, scene)) or 0)
        is_val = scene_number == _VAL_SCENE and int(number) >= _VAL_FIRST
        if self.part == "val":
            return is_val
        return (scene_number == _TEST_SCENE) == (self.part == "test") and not is_val

    def require_frames(self, found: Sequence[object], variants: Sequence[Path], root: Path) -> None:
        """Raise DatasetError if no frame was found in the folders of the variants."""
        if not found:
            there = [f"{variant.parent.name}/{variant.name}" for variant in variants]
            raise DatasetError(
                f"{root}: no frames of the split {self.part!r} in "
                f"{', '.join(self.scenes or ['its scenes'])} with "
                f"{', '.join(self.variants or ['its variants'])}: choose among those there, "
                f"{list_names(there)}"
            )


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _SplitRecipe(_ScenesRecipe):
    """The keys of Virtual KITTI.

    Attributes:
        split: "train", "val" and "test" have the paper's sizes (11,112 / 2,320 / 3,576). Scene01 is
            the test set, the last 290 frames of Scene20 are the validation set, and all others,
            including the start of Scene20, are the training set. "all" is every frame.
    """

    split: Split = "train"

    @property
    def part(self) -> Split:
        """See `_ScenesRecipe.part`."""
        return self.split


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKittiRecipe(_SplitRecipe):
    """Options of Virtual KITTI 2 in a recipe.

    Attributes:
        cameras: numbers of the cameras: 0 = left, 1 = right.
    """

    kind: Literal["virtual-kitti"] = "virtual-kitti"
    cameras: Annotated[tuple[Literal[0, 1], ...], Field(min_length=1, max_length=2)] = (0,)

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        return RecordedFrames(_list_second_edition(folder, classes, self, self.cameras))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedRecipe(_ScenesRecipe):
    """Options of scenes that `ssdnet-render` wrote; the folder is the split.

    Attributes:
        scans: feed the scans of the rendered LiDAR, with parallax and panes, instead of lines
            simulated from the camera's depth.
    """

    kind: Literal["rendered"] = "rendered"
    scans: bool = False

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        frames = _list_second_edition(folder, classes, self, scans=self.scans)
        return RecordedFrames(frames, "ordered")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKitti1Recipe(_SplitRecipe):
    """Options of Virtual KITTI 1.3.1, the edition of the paper's experiments."""

    kind: Literal["virtual-kitti-1"] = "virtual-kitti-1"

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """See `SourceRecipe.open`."""
        return RecordedFrames(_list_first_edition(folder, classes, self))


_read_depth = partial(read_depth, depth_scale=_UNITS_A_METRE)


@dataset_errors()
def _list_second_edition(
    root: Path,
    classes: ClassTable,
    recipe: _ScenesRecipe,
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
    taken = [each for each in variants if recipe.takes_variant(each.parent.name, each.name)]
    frames: list[SetFrame] = []
    for variant, camera in product(taken, cameras):
        frames += _list_camera(variant, camera, classes, recipe, scans=scans)
    recipe.require_frames(frames, variants, root)
    return frames


def _list_camera(
    variant: Path, camera: int, classes: ClassTable, recipe: _ScenesRecipe, *, scans: bool
) -> Iterator[SetFrame]:
    scene, kinds = variant.parent.name, ("rgb", "depth", "classSegmentation", "lidar")
    rgb, depth, labels, lidar = (variant / "frames" / k / f"Camera_{camera}" for k in kinds)
    images = sorted(require_folder(rgb, "the images").glob("rgb_*.jpg"))
    pictures = {path.stem.removeprefix("rgb_"): path for path in images}
    numbers = [n for n in pictures if n.isdecimal() and recipe.takes(scene, n)]
    colors = _read_colors(variant / "colors.txt", classes)
    truth = {
        "depth": Truth(require_files(depth, "depth", numbers, "depth_{}.png"), _read_depth),
        "semantic": Truth(require_files(labels, "classes", numbers, "classgt_{}.png"), colors.read),
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
def _list_first_edition(root: Path, classes: ClassTable, recipe: _ScenesRecipe) -> list[SetFrame]:
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
        if not recipe.takes_variant(scene, variant.name):
            continue
        source, place = FolderSource(variant, rig), Path(scene, variant.name)
        listed = [
            frame
            for frame in source.list_frames()
            if frame.name.isdecimal() and recipe.takes(scene, frame.name)
        ]
        names = [frame.name for frame in listed]
        depth, labels = (
            require_files(root / kind / place, "its frames", names)
            for kind in (_DEPTH_1, _CLASSES_1)
        )
        file = f"{scene}_{variant.name}_scenegt_rgb_encoding.txt"
        colors = _read_colors(root / _CLASSES_1 / file, classes)
        truth = {"depth": Truth(depth, _read_depth), "semantic": Truth(labels, colors.read)}
        frames += pair(source, listed, str(place), truth)
    recipe.require_frames(frames, variants, root / _RGB_1)
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
