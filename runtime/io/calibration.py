"""How LiDAR returns fall into a camera's image: read from the files that stacks have."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.kitti_calibration import NumbersFile, chain
from runtime.projection import OcclusionFilter, project_points

_TOML_KEYS = {"intrinsics", "extrinsics", "size"}
_RAW_FILES = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt")


@dataclass(frozen=True, eq=False)
class Calibration:
    """Intrinsics and extrinsics of one camera and one LiDAR.

    intrinsics: float64 (3, 3) of the rectified camera, in pixels of its images
    extrinsics: float64 (4, 4) from the LiDAR's frame to the camera's [m]; the camera looks along z,
        x to the right
    size: (height, width) of the images; None = not said
    occlusion: takes returns away that the camera cannot see; None = keeps them
    Raises InputError for matrices that cannot be those.
    """

    intrinsics: NDArray[np.float64]
    extrinsics: NDArray[np.float64]
    size: tuple[int, int] | None = None
    occlusion: OcclusionFilter | None = None

    def __post_init__(self) -> None:
        """Check by projecting nothing."""
        project_points(
            np.zeros((0, 3), np.float32), self.intrinsics, self.extrinsics, self.size or (1, 1)
        )

    @property
    def focal_length_px(self) -> float:
        """The focal length fx."""
        return float(self.intrinsics[0, 0])

    def project(self, points: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
        """Return the sparse depth map, float32 (H, W) [m], of a scan, see `project_points`.

        size: (height, width) of the image. Raises InputError if it is not the calibration's.
        """
        self.require_size(size)
        return project_points(
            points, self.intrinsics, self.extrinsics, size, occlusion=self.occlusion
        )

    def require_size(self, size: tuple[int, ...]) -> None:
        """Raise InputError unless images of this (height, width) are the calibration's."""
        if self.size not in (None, size):
            raise InputError(
                f"the calibration is of images of {self.size} (height, width), got one of {size}: "
                "scale the intrinsics with the image"
            )

    def check(self, points: Any) -> None:
        """Raise InputError unless `points` is a scan, float32 (N, 3) or wider [m]."""
        sliced = points[:0] if isinstance(points, np.ndarray) and points.ndim else points
        project_points(sliced, self.intrinsics, self.extrinsics, (1, 1))

    @classmethod
    def from_file(cls, path: Path | str, *, camera: int = 2) -> "Calibration":
        """Read a TOML file (`from_toml`), or, of any other name, KITTI's (`from_kitti`).

        Raises InputError as they do.
        """
        if Path(path).suffix.lower() == ".toml":
            return cls.from_toml(path)
        return cls.from_kitti(path, camera=camera)

    @classmethod
    def from_kitti(cls, path: Path | str, *, camera: int = 2) -> "Calibration":
        """Read KITTI's calibration.

        path: a folder of raw data's calib_cam_to_cam.txt and calib_velo_to_cam.txt, or one file
            with P2, R0_rect and Tr_velo_to_cam (object) or P2 and Tr (odometry)
        camera: whose images, 0 to 3
        Raises InputError for a missing file, a missing name or a wrong count of numbers.
        """
        path = Path(path)
        size, rectify = None, np.eye(3)
        if path.is_dir():
            cameras = NumbersFile(path / "calib_cam_to_cam.txt")
            scanner = NumbersFile(path / "calib_velo_to_cam.txt")
            projection = cameras.matrix(f"P_rect_{camera:02d}", 3, 4)
            rectify = cameras.matrix("R_rect_00", 3, 3)
            to_camera = np.hstack([scanner.matrix("R", 3, 3), scanner.matrix("T", 3, 1)])
            width, height = cameras.matrix(f"S_rect_{camera:02d}", 2, 1)[:, 0]
            size = (int(height), int(width))
        elif path.name in _RAW_FILES:
            raise InputError(f"{path} is one of two, {' and '.join(_RAW_FILES)}: give their folder")
        else:
            numbers = NumbersFile(path)
            projection = numbers.matrix(f"P{camera}", 3, 4)
            odometry = "Tr" in numbers
            if not odometry:
                rectify = numbers.matrix("R0_rect", 3, 3)
            to_camera = numbers.matrix("Tr" if odometry else "Tr_velo_to_cam", 3, 4)
        return cls(*chain(projection, rectify, to_camera), size)

    @classmethod
    def from_camera_info(cls, info: Mapping[str, Any], extrinsics: Any) -> "Calibration":
        """Take the fields of a ROS CameraInfo: P of its rectified images, else K.

        info: "p" or "P" (12 numbers), "k" or "K" (9) and "d" or "D", "height", "width"
        extrinsics: (4, 4) from the LiDAR's frame to the camera's optical frame, as tf gives it
        Raises InputError if they are missing, or if the image is distorted and only K is there.
        """
        fields = {str(key).lower(): value for key, value in info.items()}
        projection = _matrix("P of the CameraInfo", fields.get("p", [0] * 12), 3, 4)
        shift = np.eye(4)
        if projection.any():
            intrinsics = projection[:, :3]
            shift[0, 3] = projection[0, 3] / (projection[0, 0] or 1)  # the right one of two
        elif "k" in fields:
            intrinsics = _matrix("K of the CameraInfo", fields["k"], 3, 3)
            if np.any(np.asarray(fields.get("d", []), dtype=np.float64)):
                raise InputError(
                    "the CameraInfo has distortion but no P: rectify the images first "
                    "(image_proc), and give the rectified camera's"
                )
        else:
            raise InputError("the CameraInfo has neither p nor k: give its fields as a mapping")
        size = None
        if fields.get("height") and fields.get("width"):
            size = (int(fields["height"]), int(fields["width"]))
        return cls(intrinsics, shift @ _matrix("extrinsics", extrinsics, 4, 4), size)

    @classmethod
    def from_toml(cls, path: Path | str) -> "Calibration":
        """Read a TOML file of `intrinsics` (3 rows of 3), `extrinsics` (4 of 4) and, optionally,
        `size` ([height, width]).

        Raises InputError for a file that cannot be read, and for unknown and missing keys.
        """
        try:
            keys = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot read the calibration {path} ({reason}): give a TOML file of intrinsics, "
                "extrinsics and optionally size"
            ) from error
        if not {"intrinsics", "extrinsics"} <= keys.keys() <= _TOML_KEYS:
            raise InputError(
                f"{path} has the keys {', '.join(sorted(keys)) or 'none'}, expected intrinsics, "
                "extrinsics and optionally size"
            )
        size = keys.get("size")
        return cls(
            _matrix(f"intrinsics of {path}", keys["intrinsics"], 3, 3),
            _matrix(f"extrinsics of {path}", keys["extrinsics"], 4, 4),
            tuple(size) if isinstance(size, list) else size,
        )


def _matrix(name: str, numbers: Any, rows: int, columns: int) -> NDArray[np.float64]:
    try:
        matrix = np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.size != rows * columns or not np.isfinite(matrix).all():
        raise InputError(f"{name} must be {rows} x {columns} finite numbers, got {numbers!r:.60}")
    return matrix.reshape(rows, columns)
