"""KITTI's calibration files, and its scans."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from runtime.errors import DatasetError

FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Calibration:
    """How a LiDAR return falls into the image of a colour camera, see `runtime.project_points`.

    `intrinsics` float64 (3, 3) of the rectified camera [px]; `extrinsics` float64 (4, 4) from the
    LiDAR's frame to that camera's [m]; `size` (height, width) of the rectified image [px].
    """

    intrinsics: npt.NDArray[np.float64]
    extrinsics: npt.NDArray[np.float64]
    size: tuple[int, int]


def read_calibration(path: Path | str) -> Calibration:
    """Read camera 2's projection of LiDAR returns from one text file of `name: numbers` lines.

    Needs S_rect_02, P_rect_02, R_rect_00, velo_to_cam_R and velo_to_cam_T (KITTI's own names, the
    last two with a prefix).
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
        if not np.isfinite(values).all():
            raise DatasetError(f"{self._path}: '{name}' holds NaN or infinity")
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
    return Calibration(*chain(projection, rectify, velo_to_cam), size=(int(height), int(width)))


def chain(
    projection: npt.NDArray[np.float64],
    rectify: npt.NDArray[np.float64],
    velo_to_cam: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Intrinsics (3, 3) and extrinsics (4, 4) of KITTI's matrices.

    projection: P_rect (3, 4). rectify, velo_to_cam: R_rect and Tr_velo_to_cam as (4, 4). Raises
    `DatasetError` for a projection that is none of a rectified camera.
    """
    intrinsics, beside = projection[:, :3], np.eye(4)
    focal = intrinsics[[0, 1], [0, 1]]
    if not ((focal > 0).all() and np.array_equal(intrinsics[2], (0, 0, 1))):
        raise DatasetError(
            f"P_rect is {projection.tolist()}, expected positive focal lengths and a last row that "
            "starts with 0 0 1. Restore the calibration."
        )
    # P = K [I | t]: the camera sits beside the one that the others are chained to.
    beside[:3, 3] = np.linalg.solve(intrinsics, projection[:, 3])
    return intrinsics, beside @ rectify @ velo_to_cam


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
