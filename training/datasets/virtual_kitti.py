"""Scenes in the Virtual KITTI 2 layout (Cabon et al. 2020), as `ssdnet-render` writes them."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError
from training.datasets.image_files import read_gray, read_rgb, require_folder, require_size
from training.datasets.sample import IGNORE, Sample

#: Category names of Virtual KITTI 2 and of the rendered scenes to CamVid's eleven ids.
CATEGORY_TO_CAMVID: dict[str, int] = {
    "Sky": 0,
    "Building": 1,
    "Pole": 2,
    "Road": 3,
    "Pavement": 4,
    "Tree": 5,
    "Vegetation": 5,
    "Terrain": 5,
    "TrafficSign": 6,
    "TrafficLight": 6,
    "Fence": 7,
    "GuardRail": 7,
    "Car": 8,
    "Van": 8,
    "Truck": 8,
    "Pedestrian": 9,
    "Cyclist": 10,
    "Misc": IGNORE,
    "Undefined": IGNORE,
}

#: Depth PNGs hold centimetres; 65535 is sky.
_CENTIMETRES = 0.01
_NO_DEPTH = 65535
_UNLISTED = 254


class VirtualKitti:
    """Frames of ``root/<scene>/<variant>/frames/{rgb,depth,classSegmentation}/Camera_0``.

    Every scene and variant below ``root`` by default, or those listed. Depth is metres, 0 for the
    sky. Raises DatasetError for missing folders or files, unknown colours and wrong sizes.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        scenes: Sequence[str] | None = None,
        variants: Sequence[str] | None = None,
    ) -> None:
        root = require_folder(Path(root), "scenes in the Virtual KITTI 2 layout")
        self._frames: list[tuple[Path, str]] = []
        self._colors: dict[Path, NDArray[np.uint8]] = {}
        self._intrinsics: dict[Path, dict[str, NDArray[np.float64]]] = {}
        for scene in _folders(root):
            if scenes is not None and scene.name not in scenes:
                continue
            for variant in _folders(scene):
                if variants is None or variant.name in variants:
                    self._add(variant)
        if not self._frames:
            raise DatasetError(
                f"{root}: no frames in <scene>/<variant>/frames/rgb/Camera_0 "
                f"(scenes {scenes or 'all'}, variants {variants or 'all'})."
            )

    def _add(self, variant: Path) -> None:
        folder = require_folder(variant / "frames" / "rgb" / "Camera_0", "rgb_*.jpg frames")
        for image in sorted(folder.glob("rgb_*.jpg")):
            self._frames.append((variant, image.stem.removeprefix("rgb_")))
        self._colors[variant] = _read_colors(variant / "colors.txt")
        self._intrinsics[variant] = _read_intrinsics(variant / "intrinsic.txt")

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sample:
        variant, number = self._frames[index]
        frames = variant / "frames"
        rgb = read_rgb(frames / "rgb" / "Camera_0" / f"rgb_{number}.jpg")
        size = rgb.shape[:2]
        depth_path = frames / "depth" / "Camera_0" / f"depth_{number}.png"
        centimetres = read_gray(depth_path, np.uint16)
        require_size(depth_path, centimetres.shape, size)
        depth = centimetres.astype(np.float32) * np.float32(_CENTIMETRES)
        depth[centimetres == _NO_DEPTH] = 0.0
        label_path = frames / "classSegmentation" / "Camera_0" / f"classgt_{number}.png"
        label = read_rgb(label_path)
        require_size(label_path, label.shape, size)
        if str(int(number)) not in self._intrinsics[variant]:
            raise DatasetError(f"{variant / 'intrinsic.txt'}: no row for frame {int(number)}.")
        return Sample(
            rgb=rgb,
            sparse_depth=depth,
            depth=depth,
            semantic=_ids_of_colors(label, self._colors[variant], label_path),
            intrinsics=self._intrinsics[variant][str(int(number))],
            name=f"{variant.parent.name}/{variant.name}/{number}",
        )


def _folders(path: Path) -> list[Path]:
    """Visible folders in order; hidden ones are still being rendered."""
    return sorted(p for p in path.iterdir() if p.is_dir() and not p.name.startswith("."))


def _read_colors(path: Path) -> NDArray[np.uint8]:
    """Class id of every 24-bit colour, `_UNLISTED` where the file has no such colour."""
    colors = []
    for row in _read_rows(path):
        name, values = row[0].split(":")[0], row[-3:]
        if name not in CATEGORY_TO_CAMVID:
            raise DatasetError(
                f"{path}: unknown category {name!r}; known: {', '.join(CATEGORY_TO_CAMVID)}."
            )
        try:
            red, green, blue = (int(value) for value in values)
        except ValueError as error:
            raise DatasetError(f"{path}: {' '.join(row)!r} is not 'Category r g b'.") from error
        colors.append((red << 16 | green << 8 | blue, CATEGORY_TO_CAMVID[name]))
    return _color_table(tuple(colors))


@lru_cache(maxsize=8)  # 16 MB each, and all variants of a set share one
def _color_table(colors: tuple[tuple[int, int], ...]) -> NDArray[np.uint8]:
    table = np.full(1 << 24, _UNLISTED, dtype=np.uint8)
    for color, class_id in colors:
        table[color] = class_id
    return table


def _read_intrinsics(path: Path) -> dict[str, NDArray[np.float64]]:
    """K of Camera_0 a frame, from rows of 'frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]'."""
    intrinsics = {}
    for row in _read_rows(path):
        try:
            frame, camera = row[0], row[1]
            fx, fy, cx, cy = (float(value) for value in row[2:6])
        except (IndexError, ValueError) as error:
            raise DatasetError(
                f"{path}: {' '.join(row)!r} is not 'frame cameraID fx fy cx cy'."
            ) from error
        if camera == "0":
            intrinsics[frame] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return intrinsics


def _read_rows(path: Path) -> list[list[str]]:
    """Rows of a text table without its header."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}.") from error
    rows = [line.split() for line in lines[1:] if line.strip()]
    if not rows:
        raise DatasetError(f"{path}: no rows under its header.")
    return rows


def _ids_of_colors(
    label: NDArray[np.uint8], table: NDArray[np.uint8], path: Path
) -> NDArray[np.uint8]:
    """Class ids of an RGB label image; an unlisted colour is a DatasetError."""
    channels = label.astype(np.int32)
    ids: NDArray[np.uint8] = table[
        channels[..., 0] << 16 | channels[..., 1] << 8 | channels[..., 2]
    ]
    unlisted = ids == _UNLISTED
    if unlisted.any():
        red, green, blue = label[unlisted][0]
        raise DatasetError(
            f"{path}: colour ({red}, {green}, {blue}) is not in colors.txt. "
            "Restore the original file (JPEG compression changes colours)."
        )
    return ids
