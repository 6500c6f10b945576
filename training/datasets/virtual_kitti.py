"""Virtual KITTI 2 (Cabon et al. 2020), and scenes that `ssdnet-render` writes in its layout."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable
from training.datasets.image_files import read_gray, read_rgb, require_folder, require_size
from training.datasets.kitti_calibration import CalibrationFile, read_points
from training.datasets.sample import Sample
from training.datasets.source import Names, SourceRecipe
from training.datasets.virtual_kitti_labels import (
    ColorTable,
    read_classes,
    read_colors,
    read_rows,
)
from training.datasets.virtual_kitti_split import (
    Selection,
    Split,
    read_frame_list,
    require_every_frame,
)
from training.lidar.scan import project_lines
from training.limits import STRICT

#: Depth PNGs hold centimetres; 65535 is sky.
_CENTIMETRES = 0.01
_NO_DEPTH = 65535


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualKittiRecipe(SourceRecipe):
    """What a recipe says about Virtual KITTI 2."""

    kind: Literal["virtual_kitti"] = "virtual_kitti"
    split: Split = "train"
    #: Instead of the split's own.
    scenes: Names | None = None
    variants: Names | None = None
    #: File below ``path`` that lists the frames, rows of "scene/variant/number".
    frames: str | None = None
    #: 0 = left, 1 = right.
    cameras: Annotated[tuple[Literal[0, 1], ...], Field(min_length=1, max_length=2)] = (0,)

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        frames = None if self.frames is None else read_frame_list(folder / self.frames)
        selection = Selection(self.split, self.scenes, self.variants, frames)
        return VirtualKitti(folder, selection=selection, cameras=self.cameras, classes=classes)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RenderedRecipe(SourceRecipe):
    """What a recipe says about scenes that `ssdnet-render` wrote; the folder is the split."""

    kind: Literal["rendered"] = "rendered"
    #: All by default.
    scenes: Names | None = None
    variants: Names | None = None
    #: File below ``path`` that lists the frames, rows of "scene/variant/number".
    frames: str | None = None
    #: Feed the scans of the LiDAR that was rendered, with its parallax and its panes, instead of
    #: lines drawn from the camera's depth.
    scans: bool = False

    def open(self, folder: Path, classes: ClassTable) -> "VirtualKitti":
        """See `SourceRecipe.open`."""
        frames = None if self.frames is None else read_frame_list(folder / self.frames)
        selection = Selection("all", self.scenes, self.variants, frames)
        return VirtualKitti(folder, selection=selection, classes=classes, scans=self.scans)


class VirtualKitti:
    """Frames of ``root/<scene>/<variant>/frames/{rgb,depth,classSegmentation}/Camera_<n>``.

    ``selection`` says which frames, ``cameras`` which of 0 and 1, ``classes`` the table of the
    class ids. Depth is metres, 0 for the sky. With ``scans`` the input is the rendered LiDAR's,
    ``frames/lidar/Camera_<n>`` and ``calib.txt``, with its scan lines.

    Raises DatasetError for missing folders, files without their partners, unknown colours and wrong
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
        self._classes = classes
        self._scans = scans
        self._extrinsics: dict[Path, NDArray[np.float64]] = {}
        self._frames: list[tuple[Path, int, str]] = []
        self._colors: dict[Path, ColorTable] = {}
        self._intrinsics: dict[Path, dict[tuple[str, str], NDArray[np.float64]]] = {}
        for scene in _folders(root):
            for variant in _folders(scene):
                if selection.takes_variant(scene.name, variant.name):
                    self._add(variant, cameras, selection)
        names = [f"{v.parent.name}/{v.name}/{number}" for v, _, number in self._frames]
        require_every_frame(selection, names, root)

    def _add(self, variant: Path, cameras: Sequence[int], selection: Selection) -> None:
        for camera in cameras:
            folder = require_folder(
                variant / "frames" / "rgb" / f"Camera_{camera}", "rgb_*.jpg frames"
            )
            numbers = [
                number
                for number in sorted(p.stem.removeprefix("rgb_") for p in folder.glob("rgb_*.jpg"))
                if selection.takes(variant.parent.name, variant.name, number)
            ]
            for kind, stem in (("depth", "depth"), ("classSegmentation", "classgt")):
                other = require_folder(
                    variant / "frames" / kind / f"Camera_{camera}", f"{stem}_*.png"
                )
                require_partners(other, [f"{stem}_{number}.png" for number in numbers])
            if self._scans:
                lidar = variant / "frames" / "lidar" / f"Camera_{camera}"
                require_partners(
                    require_folder(lidar, "the LiDAR's scans, which ssdnet-render writes"),
                    [f"lidar_{number}.bin" for number in numbers],
                )
            self._frames += [(variant, camera, number) for number in numbers]
        self._colors[variant] = read_colors(variant / "colors.txt", self._classes)
        self._intrinsics[variant] = _read_intrinsics(variant / "intrinsic.txt")
        if self._scans:
            self._extrinsics[variant] = np.eye(4)
            calibration = CalibrationFile(variant / "calib.txt")
            self._extrinsics[variant][:3] = calibration.matrix("Tr_velo_to_cam", 3, 4)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sample:
        variant, camera, number = self._frames[index]
        frames, folder = variant / "frames", f"Camera_{camera}"
        rgb = read_rgb(frames / "rgb" / folder / f"rgb_{number}.jpg")
        size = (rgb.shape[0], rgb.shape[1])
        depth = read_centimetres(frames / "depth" / folder / f"depth_{number}.png", size)
        intrinsics = self._intrinsics[variant].get((str(int(number)), str(camera)))
        if intrinsics is None:
            raise DatasetError(
                f"{variant / 'intrinsic.txt'}: no row for frame {int(number)} of camera {camera}."
            )
        sparse_depth = scan_line = None
        if self._scans:
            points = read_points(frames / "lidar" / folder / f"lidar_{number}.bin")
            sparse_depth, scan_line = project_lines(
                points, intrinsics, self._extrinsics[variant], size
            )
        return Sample(
            rgb=rgb,
            depth=depth,
            sparse_depth=sparse_depth,
            scan_line=scan_line,
            semantic=read_classes(
                frames / "classSegmentation" / folder / f"classgt_{number}.png",
                self._colors[variant],
                size,
            ),
            intrinsics=intrinsics,
            name=f"{variant.parent.name}/{variant.name}/{number}" + (f"/{camera}" * bool(camera)),
        )


def read_centimetres(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """Read a depth map of Virtual KITTI: float32 (H, W), metres, 0 = sky. Raises DatasetError."""
    centimetres = read_gray(path, np.uint16)
    require_size(path, centimetres.shape, size)
    depth = centimetres.astype(np.float32) * np.float32(_CENTIMETRES)
    depth[centimetres == _NO_DEPTH] = 0.0
    return depth


def require_partners(folder: Path, names: Sequence[str]) -> None:
    """Raise DatasetError if a file of these names is missing in a folder."""
    there = {path.name for path in folder.iterdir()}
    missing = [name for name in names if name not in there]
    if missing:
        raise DatasetError(
            f"{folder / missing[0]}: missing ({len(missing)} of {len(names)} frames lack it)."
        )


def _folders(path: Path) -> list[Path]:
    """Visible folders in order; hidden ones are still being rendered."""
    return sorted(p for p in path.iterdir() if p.is_dir() and not p.name.startswith("."))


def _read_intrinsics(path: Path) -> dict[tuple[str, str], NDArray[np.float64]]:
    """K of each (frame, camera), from rows of 'frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]'."""
    intrinsics = {}
    for row in read_rows(path):
        try:
            frame, camera = row[0], row[1]
            fx, fy, cx, cy = (float(value) for value in row[2:6])
        except (IndexError, ValueError) as error:
            raise DatasetError(
                f"{path}: {' '.join(row)!r} is not 'frame cameraID fx fy cx cy'."
            ) from error
        intrinsics[frame, camera] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return intrinsics
