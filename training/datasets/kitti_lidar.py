"""LiDAR returns of KITTI recordings: scan lines, projection, and honest depth targets.

There is no dense depth ground truth beside a recorded stream. Depth is measured by feeding some
of the scan lines and scoring on the others, so returns have to be told apart by line first and
projected afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from runtime.errors import DatasetError

FloatArray = npt.NDArray[np.float32]

# Steps back in azimuth smaller than this are jitter inside one line, not the next line [degrees].
_LINE_BREAK_DEG = 5.0


@dataclass(frozen=True)
class Calibration:
    """How a LiDAR return falls into the image of a colour camera.

    `velo_to_image` float64 (3, 4): `[u w, v w, w] = velo_to_image @ [x, y, z, 1]`, with `w` the
    depth along the optical axis [m]. `intrinsics` float64 (3, 3) of the rectified camera [px].
    `size` (height, width) of the rectified image [px].
    """

    velo_to_image: npt.NDArray[np.float64]
    intrinsics: npt.NDArray[np.float64]
    size: tuple[int, int]


def read_calibration(path: Path | str) -> Calibration:
    """Read camera 2's projection of LiDAR returns from one text file of `name: numbers` lines.

    Needs S_rect_02, P_rect_02, R_rect_00, velo_to_cam_R and velo_to_cam_T (KITTI's own names, the
    last two with a prefix) and chains them as P_rect_02 R_rect_00 [R T].
    Raises `DatasetError` for a missing file, a missing name or a wrong count of numbers.
    """
    numbers = CalibrationFile(Path(path))
    return _chain(numbers, numbers, camera=2, prefix="velo_to_cam_")


def read_raw_calibration(folder: Path | str, camera: int) -> Calibration:
    """Read a colour camera's projection from the files of a day of KITTI raw data.

    `folder` holds calib_cam_to_cam.txt and calib_velo_to_cam.txt; `camera` is 2 or 3. Raises
    `DatasetError` as `read_calibration`.
    """
    cameras = CalibrationFile(Path(folder) / "calib_cam_to_cam.txt")
    velodyne = CalibrationFile(Path(folder) / "calib_velo_to_cam.txt")
    return _chain(cameras, velodyne, camera=camera, prefix="")


class CalibrationFile:
    """A text file of `name: numbers` lines. Raises `DatasetError` if it cannot be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise DatasetError(f"cannot read the calibration {path}: {error}") from error
        self._entries = dict(
            line.split(":", 1)
            for line in lines
            if ":" in line and not line.lstrip().startswith("#")
        )

    def matrix(self, name: str, *shape: int) -> npt.NDArray[np.float64]:
        """The numbers under a name. Raises `DatasetError` if they are missing or not as many."""
        count = int(np.prod(shape))
        if name not in self._entries:
            raise DatasetError(
                f"{self._path} has no line '{name}:'; expected {count} numbers under it"
            )
        try:
            values = np.array(self._entries[name].split(), dtype=np.float64)
        except ValueError as error:
            raise DatasetError(f"{self._path}: '{name}' holds something not a number") from error
        if values.size != count:
            raise DatasetError(
                f"{self._path}: '{name}' has {values.size} numbers, expected {count}"
            )
        return values.reshape(shape)


def _chain(
    cameras: CalibrationFile, velodyne: CalibrationFile, *, camera: int, prefix: str
) -> Calibration:
    projection = cameras.matrix(f"P_rect_{camera:02d}", 3, 4)
    rectify = np.eye(4)
    rectify[:3, :3] = cameras.matrix("R_rect_00", 3, 3)
    velo_to_cam = np.eye(4)
    velo_to_cam[:3, :3] = velodyne.matrix(f"{prefix}R", 3, 3)
    velo_to_cam[:3, 3] = velodyne.matrix(f"{prefix}T", 3)
    width, height = cameras.matrix(f"S_rect_{camera:02d}", 2)
    return Calibration(
        velo_to_image=projection @ rectify @ velo_to_cam,
        intrinsics=projection[:, :3],
        size=(int(height), int(width)),
    )


def read_points(path: Path | str) -> FloatArray:
    """Read one scan: float32 (N, 4) of x, y, z [m] in the LiDAR frame and reflectance 0..1.

    Raises `DatasetError` if the file is missing or is not whole records of four float32.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"cannot read the scan {path}: {error}") from error
    if len(data) % 16:
        raise DatasetError(
            f"{path} has {len(data)} bytes, expected a multiple of 16 (x, y, z, reflectance as "
            "float32); the file is truncated or of another format"
        )
    return np.frombuffer(data, dtype="<f4").reshape(-1, 4).astype(np.float32)


def scan_line_of(points: FloatArray) -> npt.NDArray[np.int64]:
    """Number the scan line of every return: int64 (N,), from 0 without gaps, top to bottom.

    `points` float32 (N, >= 3) in KITTI's own order: line after line, the sensor's upper block of
    lasers and then its lower one, which overlap by a line or two; each line counter-clockwise from
    straight ahead. Cropping to the camera's view keeps that order, so a line ends
    where the azimuth (0..360 degrees) steps back. Elevation cannot tell lines apart: within one
    line it wanders by several line spacings, because the sensor is tilted.
    A line without any return in view leaves no trace and gets no number.
    """
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    line = np.zeros(len(points), dtype=np.int64)
    line[1:] = np.cumsum(np.diff(azimuth) < -_LINE_BREAK_DEG)
    return line


def project(points: FloatArray, calibration: Calibration, size: tuple[int, int]) -> FloatArray:
    """Project returns into a sparse depth map: float32 (H, W) [m], 0 = no return.

    `points` float32 (N, >= 3) in the LiDAR frame [m]; `size` (height, width) [px]. A return at
    (u, v) falls into pixel (floor u, floor v); of several in one pixel the nearest wins. Returns
    behind the camera, outside the image or not finite are left out. Occlusion is not checked,
    see `withhold_occluded`.
    """
    height, width = size
    xyz = points[:, :3].astype(np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    image = xyz @ calibration.velo_to_image[:, :3].T + calibration.velo_to_image[:, 3]
    image = image[image[:, 2] > 0]
    depth = image[:, 2]
    u = np.floor(image[:, 0] / depth)
    v = np.floor(image[:, 1] / depth)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = v[inside].astype(np.int64) * width + u[inside].astype(np.int64)
    sparse_depth = np.full(height * width, np.inf, dtype=np.float32)
    np.minimum.at(sparse_depth, pixel, depth[inside].astype(np.float32))
    sparse_depth[np.isinf(sparse_depth)] = 0.0
    return sparse_depth.reshape(height, width)


def project_lines(
    points: FloatArray, calibration: Calibration, size: tuple[int, int]
) -> tuple[FloatArray, npt.NDArray[np.int16]]:
    """Project a scan and keep apart by which line each pixel was measured.

    `points` as in `scan_line_of`. Returns depth float32 (H, W) [m], 0 = none, and the line int16
    (H, W), -1 = none; the nearest return of a pixel wins.
    """
    lines = scan_line_of(points)
    depth = np.zeros(size, dtype=np.float32)
    scan_line = np.full(size, -1, dtype=np.int16)
    for line in range(int(lines.max()) + 1 if len(lines) else 0):
        returns = project(points[lines == line], calibration, size)
        nearer = (returns > 0) & ((depth == 0) | (returns < depth))
        depth[nearer] = returns[nearer]
        scan_line[nearer] = line
    return depth, scan_line


def withhold_occluded(
    target: FloatArray,
    returns: FloatArray,
    *,
    window: tuple[int, int] = (15, 9),
    relative_gap: float = 0.1,
    gap_m: float = 0.5,
) -> FloatArray:
    """Drop the returns of `target` that the camera cannot see: float32 (H, W) [m], a new array.

    The LiDAR sits above and behind the camera and looks past near objects, so far returns show
    through them in the projection. A return at depth d is dropped if a return nearer than
    `d * (1 - relative_gap) - gap_m` lies in the `window` (height, width, odd) [px] around it.
    Background seen right beside an object's edge goes too; surfaces seen at a grazing angle stay.

    `target`, `returns` float32 (H, W) [m], 0 = none; give all returns of the frame as `returns`,
    whatever part of them `target` holds.
    """
    measured = np.where(returns > 0, returns, np.inf).astype(np.float32)
    nearest = cv2.erode(measured, np.ones(window, dtype=np.uint8))
    visible = nearest >= target * (1.0 - relative_gap) - gap_m
    return np.where(visible, target, 0.0).astype(np.float32)
