"""Virtual KITTI 2 (Cabon et al. 2020) and 1.3.1 (Gaidon et al. 2016), and rendered scenes.

`ssdnet-render` writes its scenes in the layout of edition 2.
"""

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.files.read_input import read_text
from runtime.geometry.kitti_calibration import NumbersFile
from training.datasets.class_mapping import ClassTable, class_ids
from training.datasets.files import (
    dataset_errors,
    read_depth,
    read_points,
    read_rgb,
    require_folder,
    require_size,
)
from training.datasets.sample import FrameList, Sample, make_frame
from training.datasets.source_recipe import Names, SourceRecipe
from training.datasets.virtual_kitti_split import Selection, Split
from training.lidar.scan import project_lines
from training.limits import STRICT

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

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        selection = Selection(self.split, self.scenes, self.variants)
        return VirtualKitti(_list_second_edition(folder, selection, self.cameras), classes)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedRecipe(_SelectionRecipe):
    """Options of scenes that `ssdnet-render` wrote; the folder is the split.

    Attributes:
        scans: feed the scans of the rendered LiDAR, with parallax and panes, instead of lines
            simulated from the camera's depth.
    """

    kind: Literal["rendered"] = "rendered"
    scans: bool = False

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        selection = Selection("all", self.scenes, self.variants)
        return VirtualKitti(_list_second_edition(folder, selection, scans=self.scans), classes)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKitti1Recipe(_SelectionRecipe):
    """Options of Virtual KITTI 1.3.1, the edition of the paper's experiments."""

    kind: Literal["virtual-kitti-1"] = "virtual-kitti-1"
    split: Split = "train"

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        selection = Selection(self.split, self.scenes, self.variants)
        return VirtualKitti(_list_first_edition(folder, selection), classes)


@dataclasses.dataclass(frozen=True)
class _Frame:
    """The files of a frame; `scan` is that of a rendered LiDAR, with its matrix to the camera."""

    name: str
    rgb: Path
    depth: Path
    labels: Path
    colors: Path
    intrinsics: NDArray[np.float64]
    scan: tuple[Path, NDArray[np.float64]] | None = None


class VirtualKitti(FrameList):
    """Frames of either edition.

    Raises:
        DatasetError: if a file is unreadable, a colour is unknown, or a size is wrong.
    """

    def __init__(self, frames: Sequence[_Frame], classes: ClassTable) -> None:
        self._frames = frames
        self.images = [frame.rgb for frame in frames]
        self._colors = {path: _read_colors(path, classes) for path in {f.colors for f in frames}}

    def __getitem__(self, index: int) -> Sample:
        frame = self._frames[index]
        rgb = read_rgb(frame.rgb)
        size = (rgb.shape[0], rgb.shape[1])
        depth = read_depth(frame.depth, size, depth_scale=_UNITS_A_METRE)
        returns = scan_line = None
        if frame.scan is not None:
            path, to_camera = frame.scan
            points = read_points(path)
            returns, scan_line = project_lines(points, frame.intrinsics, to_camera, size)
        labels = _read_classes(frame.labels, self._colors[frame.colors], size)
        measured = make_frame(rgb, frame.name, returns=returns, intrinsics=frame.intrinsics)
        return Sample(measured, {"depth": depth, "semantic": labels}, scan_line)


@dataset_errors()
def _list_second_edition(
    root: Path, selection: Selection, cameras: Sequence[int] = (0,), *, scans: bool = False
) -> list[_Frame]:
    """List `root/<scene>/<variant>/frames/{rgb,depth,classSegmentation}/Camera_<n>`.

    With `scans`, `frames/lidar/Camera_<n>` and `calib.txt`, which ssdnet-render writes, are listed,
    too.
    """
    require_folder(root, "scenes in the Virtual KITTI 2 layout")
    frames: list[_Frame] = []
    variants = [variant for scene in _folders(root) for variant in _folders(scene)]
    for variant in variants:
        scene = variant.parent.name
        for camera in cameras if selection.takes_variant(scene, variant.name) else ():
            folders = {
                kind: variant / "frames" / kind / f"Camera_{camera}"
                for kind in ("rgb", "depth", "classSegmentation", "lidar")
            }
            images = require_folder(folders["rgb"], "the images").glob("rgb_*.jpg")
            found = sorted(path.stem.removeprefix("rgb_") for path in images)
            numbers = [n for n in found if n.isdecimal() and selection.takes(scene, n)]
            parts = {"depth": "depth_{}.png", "classSegmentation": "classgt_{}.png"}
            if scans:
                parts["lidar"] = "lidar_{}.bin"
                to_camera = NumbersFile(variant / "calib.txt").matrix("Tr_velo_to_cam", 3, 4)
                to_camera = np.vstack([to_camera, np.eye(4)[3]])
            for kind, name in parts.items():
                require_folder(folders[kind], name, files=[name.format(n) for n in numbers])
            intrinsics = _read_intrinsics(variant / "intrinsic.txt", camera)
            for number in numbers:
                if int(number) not in intrinsics:
                    raise DatasetError(
                        f"{variant / 'intrinsic.txt'}: no row {_INTRINSICS_ROW} of frame "
                        f"{int(number)}, camera {camera}: restore the file"
                    )
                frames.append(
                    _Frame(
                        f"{scene}/{variant.name}/{number}" + (f"/{camera}" if camera else ""),
                        folders["rgb"] / f"rgb_{number}.jpg",
                        folders["depth"] / f"depth_{number}.png",
                        folders["classSegmentation"] / f"classgt_{number}.png",
                        variant / "colors.txt",
                        intrinsics[int(number)],
                        (folders["lidar"] / f"lidar_{number}.bin", to_camera) if scans else None,
                    )
                )
    selection.require_frames(frames, variants, root)
    return frames


@dataset_errors()
def _list_first_edition(root: Path, selection: Selection) -> list[_Frame]:
    """List `root/vkitti_1.3.1_{rgb,depthgt,scenegt}/<scene>/<variant>/<number>.png`.

    Colours are in `vkitti_1.3.1_scenegt/<scene>_<variant>_scenegt_rgb_encoding.txt`; scenes are
    called "0001".
    """
    for kind in (_RGB_1, _DEPTH_1, _CLASSES_1):
        require_folder(root / kind, "a folder of Virtual KITTI 1.3.1")
    frames: list[_Frame] = []
    variants = sorted(path for path in (root / _RGB_1).glob("*/*") if path.is_dir())
    for variant in variants:
        scene = variant.parent.name
        if not selection.takes_variant(scene, variant.name):
            continue
        numbers = sorted(path.stem for path in variant.glob("*.png"))
        numbers = [n for n in numbers if n.isdecimal() and selection.takes(scene, n)]
        depth, labels = (root / kind / scene / variant.name for kind in (_DEPTH_1, _CLASSES_1))
        for folder in (depth, labels):
            require_folder(folder, "its frames", files=[f"{n}.png" for n in numbers])
        colors = root / _CLASSES_1 / f"{scene}_{variant.name}_scenegt_rgb_encoding.txt"
        for number in numbers:
            name = f"{scene}/{variant.name}/{number}"
            rgb, *others = (folder / f"{number}.png" for folder in (variant, depth, labels))
            frames.append(_Frame(name, rgb, others[0], others[1], colors, _INTRINSICS_1))
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


@dataclasses.dataclass(frozen=True, eq=False)
class _Colors:
    """Colours of a file and their ids.

    Attributes:
        path: the file.
        colors: int32 (n,), ascending, r << 16 | g << 8 | b.
        ids: uint8 (n,).
    """

    path: Path
    colors: NDArray[np.int32]
    ids: NDArray[np.uint8]


@dataset_errors()
def _read_colors(path: Path, classes: ClassTable) -> _Colors:
    """Read the colours of a file and their ids in a class table.

    The rows are 'Category r g b' in Virtual KITTI 2, and 'Category:instance r g b' in 1.3.1.
    """
    known = class_ids("virtual_kitti", classes)
    found: dict[int, int] = {}
    for row in filter(None, map(str.split, read_text(path).splitlines()[1:])):
        name = row[0].split(":")[0]
        if name not in known:
            raise DatasetError(f"{path}: unknown category {name!r}; known: {', '.join(known)}")
        try:
            red, green, blue = (int(value) for value in row[-3:])
            color = int.from_bytes((red, green, blue), "big")
        except ValueError as error:
            raise DatasetError(f"{path}: {' '.join(row)!r} is not 'Category r g b'") from error
        found[color] = known[name]
    if not found:
        raise DatasetError(f"{path}: no rows under its header")
    colors = sorted(found)
    ids = np.array([found[color] for color in colors], dtype=np.uint8)
    return _Colors(path, np.array(colors, dtype=np.int32), ids)


def _read_classes(path: Path, table: _Colors, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the class ids, uint8 (H, W), of a colour image; DatasetError for other colours."""
    label = read_rgb(path)
    require_size(path, label.shape, size)
    # The bytes blue, green, red and 0 are r << 16 | g << 8 | b as a little-endian integer.
    packed = cv2.cvtColor(label, cv2.COLOR_RGB2BGRA)
    packed[..., 3] = 0
    color = packed.view("<i4").ravel()
    # Neighbouring pixels mostly have the same colour, so each run of equal pixels is looked up
    # once.
    starts = np.flatnonzero(np.diff(color, prepend=-1))
    run = color[starts]
    index = np.searchsorted(table.colors, run).clip(max=len(table.colors) - 1)
    unlisted = table.colors[index] != run
    if unlisted.any():
        red, green, blue = label.reshape(-1, 3)[starts[unlisted][0]]
        raise DatasetError(
            f"{path}: colour ({red}, {green}, {blue}) is not in {table.path.name}: "
            "restore the original file (JPEG compression changes colours)"
        )
    ids: NDArray[np.uint8] = np.repeat(table.ids[index], np.diff(starts, append=color.size))
    return ids.reshape(size)
