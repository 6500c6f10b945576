"""Calibration of a camera and a LiDAR, and the files that it is read from."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from runtime.base.arguments import shown
from runtime.base.arrays import Float32, Float64, Size, UInt8
from runtime.base.errors import InputError
from runtime.files.read_input import read_toml
from runtime.geometry.assumptions import assume
from runtime.geometry.kitti_calibration import NumbersFile, compose_matrices, kitti_image_size
from runtime.geometry.lens import PLUMB_BOB, Lens, cache_key, rectifying_maps
from runtime.geometry.projection import project_points, split_projection
from runtime.geometry.region import region_of_images
from runtime.geometry.rigid import finite_matrix, nearest_rigid
from runtime.geometry.units import check_mount_distance, check_principal_point

RAW_CAMERAS, RAW_SCANNER = "calib_cam_to_cam.txt", "calib_velo_to_cam.txt"
# Example of a file, which is filled in for another camera.
_EXAMPLE = """\
intrinsics = [[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]]  # pixels
# From the LiDAR's frame to the camera's, metres; points_in = "camera" where they are the same.
extrinsics = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, -0.08], [1.0, 0.0, 0.0, -0.27], [0, 0, 0, 1]]
size = [375, 1242]  # height, width of the images
# lens = "plumb_bob"  # only of images that are not rectified
# distortion = [-0.369, 0.197, 0.0014, 0.0006, -0.068]"""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Intrinsics and extrinsics of one camera and one LiDAR.

    Attributes:
        intrinsics: float64 (3, 3), in pixels of the images.
        extrinsics: float64 (4, 4) from the LiDAR's frame to the camera's [m]; the camera looks
            along z, and x points to the right.
        size: (height, width) of the images; None if unknown.
        body_from_lidar: float64 (4, 4) from the LiDAR's frame to the vehicle's [m], needed for
            poses of the frame "body"; None if unknown.
        lens: model of the images' distortion, "plumb_bob", "rational_polynomial" or "equidistant"
            (a fisheye); None: the images are rectified. Returns are projected into the distorted
            images; the images are not resampled.
        distortion: coefficients of the lens, in the order of OpenCV and ROS.

    Raises:
        InputError: if a matrix is invalid, see `nearest_rigid`, the lens is unknown, or the
            coefficients do not fit the lens.
    """

    intrinsics: Float64
    extrinsics: Float64
    size: Size | None = None
    body_from_lidar: Float64 | None = None
    lens: str | None = None
    distortion: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check the matrices and the lens, and replace nearly rigid matrices by rigid ones."""
        for name in ("extrinsics", "body_from_lidar"):
            if (matrix := getattr(self, name)) is not None:
                object.__setattr__(self, name, nearest_rigid(name, matrix))
        project_points(
            np.zeros((0, 3), np.float32), self.intrinsics, self.extrinsics, self.size or (1, 1)
        )
        if (self.lens is None) != (self.distortion is None):
            raise InputError(
                "lens and distortion belong together: give the model of the lens and its "
                f"coefficients, got lens {shown(self.lens)} and distortion {shown(self.distortion)}"
            )
        if self.lens is not None:
            Lens.of(self.lens, self.distortion)  # raises for wrong coefficients
        check_mount_distance(self.extrinsics, self.body_from_lidar)
        if self.size is not None:
            check_principal_point(self.intrinsics, self.size)

    @property
    def focal_length_px(self) -> float:
        """The focal length fx."""
        return float(self.intrinsics[0, 0])

    @property
    def lens_model(self) -> Lens | None:
        """The lens with its coefficients; None if the images are not distorted."""
        if self.lens is None:
            return None
        model = Lens.of(self.lens, self.distortion)
        return None if model.is_ideal else model

    @property
    def rectified(self) -> "Calibration":
        """The calibration without lens, for the images that `rectify` returns."""
        return replace(self, lens=None, distortion=None)

    def rectify(self, rgb: UInt8) -> UInt8:
        """Return an image without distortion, of the same size and focal length.

        Parts of the scene that fall outside this size are lost; pixels without a source are black.

        Args:
            rgb: uint8 (H, W, 3).

        Raises:
            InputError: if the size is not the calibration's.
        """
        size = rgb.shape[0], rgb.shape[1]
        self.require_size(size)
        if (lens := self.lens_model) is None:
            return rgb
        maps = rectifying_maps(lens, cache_key(self.intrinsics), size)
        return cv2.remap(rgb, *maps, cv2.INTER_LINEAR)  # type: ignore[return-value]

    def project(self, points: Float32, size: Size) -> Float32:
        """Project a scan into the image, through the lens, see `project_points`.

        Args:
            points: float32 (N, 3) or wider, metres, LiDAR frame.
            size: (height, width) of the image.

        Returns:
            float32 (height, width), metres along the optical axis, 0 where there is no return.

        Raises:
            InputError: if the size is not the calibration's or the points are invalid.
        """
        self.require_size(size)
        return project_points(points, self.intrinsics, self.extrinsics, size, lens=self.lens_model)

    def require_size(self, size: tuple[int, ...]) -> None:
        """Raise InputError if `size` is known and differs from this (height, width).

        If the size is unknown, an `AssumptionWarning` is issued for images beside the principal
        point, and for other images than KITTI's if the intrinsics are KITTI's: images may be cut at
        the bottom and right without new intrinsics.
        """
        if self.size is None:
            check_principal_point(self.intrinsics, size)
        if self.size is None and (known := kitti_image_size(self.intrinsics)) not in (None, size):
            assume(
                f"the calibration fits images of {size} (height, width), although KITTI's images "
                f"with these intrinsics have {known}",
                "subtract what is cut at the left and above from cx and cy, or scale the "
                "intrinsics, and state size in a TOML file for `calibration=`",
            )
        if self.size not in (None, size):
            swapped = self.size == size[::-1]
            remedy = "swap the two" if swapped else "scale the intrinsics with the image"
            raise InputError(
                f"the calibration is for images of {self.size} (height, width), got an image of "
                f"{size}: {remedy}"
            )

    @classmethod
    def from_file(
        cls, path: Path | str, *, camera: int = 2, rectified: bool = True, for_scans: bool = False
    ) -> "Calibration":
        """Read a .toml file with `from_toml`, anything else with `from_kitti`.

        Args:
            path: TOML file, or KITTI's file or folder.
            camera: number of KITTI's camera, 0 to 3.
            rectified: see `from_kitti`.
            for_scans: see `from_kitti`.

        Raises:
            InputError: if the calibration cannot be read.
        """
        path = Path(path)
        try:
            if path.suffix.lower() == ".toml":
                return cls.from_toml(path)
            return cls.from_kitti(path, camera=camera, rectified=rectified, for_scans=for_scans)
        except InputError as error:
            if str(path) in str(error):
                raise
            raise InputError(f"{path}: {error}") from error

    @classmethod
    def from_kitti(
        cls, path: Path | str, *, camera: int = 2, rectified: bool = True, for_scans: bool = False
    ) -> "Calibration":
        """Read KITTI's calibration.

        Args:
            path: the raw data's folder with calib_cam_to_cam.txt and calib_velo_to_cam.txt; or one
                file with P2, R0_rect and Tr_velo_to_cam (object data), with P2 and Tr (odometry),
                or with nine numbers, which are the intrinsics alone (depth selection).
            camera: number of the camera, 0 to 3.
            rectified: False for the raw data's images as they were taken, with their lens.
            for_scans: refuse a file that holds the intrinsics alone.

        Raises:
            InputError: if a file or a name is missing, or the count of numbers is wrong. If the
                file was written by another tool, the message contains a TOML file to fill in.
        """
        path = Path(path)
        if path.name in (RAW_CAMERAS, RAW_SCANNER):
            raise InputError(
                f"{path} is one of the two files {RAW_CAMERAS} and {RAW_SCANNER}: give the folder "
                "that contains both"
            )
        if os.path.isdir(path):
            return cls._from_kitti_raw(path, f"{camera:02d}", rectified=rectified)
        numbers = NumbersFile(path)
        if not numbers.is_kitti:
            raise InputError(
                f"{path} is neither TOML nor a calibration of KITTI: write a .toml file as this "
                "one of another camera (docs/recordings.md has lines of Python that print it from "
                f"files of ROS, OpenCV and Kalibr):\n{_EXAMPLE}"
            )
        if "" in numbers and for_scans:
            raise InputError(
                f"{path} holds the intrinsics alone: scans need a .toml file with intrinsics and "
                'extrinsics, or with points_in = "camera" where they are in the camera\'s frame'
            )
        if "" in numbers:
            return cls(numbers.matrix("", 3, 3), np.eye(4))
        projection, is_odometry = numbers.matrix(f"P{camera}", 3, 4), "Tr" in numbers
        rectify = np.eye(3) if is_odometry else numbers.matrix("R0_rect", 3, 3)
        to_camera = numbers.matrix("Tr" if is_odometry else "Tr_velo_to_cam", 3, 4)
        return cls(*compose_matrices(projection, rectify, to_camera))

    @classmethod
    def _from_kitti_raw(cls, folder: Path, camera: str, *, rectified: bool) -> "Calibration":
        cameras, scanner = NumbersFile(folder / RAW_CAMERAS), NumbersFile(folder / RAW_SCANNER)
        to_camera = np.hstack([scanner.matrix("R", 3, 3), scanner.matrix("T", 3, 1)])
        name = f"S_rect_{camera}" if rectified else f"S_{camera}"
        width, height = cameras.matrix(name, 1, 2)[0].astype(int).tolist()
        if rectified:
            projection = cameras.matrix(f"P_rect_{camera}", 3, 4)
            rectify = cameras.matrix("R_rect_00", 3, 3)
            return cls(*compose_matrices(projection, rectify, to_camera), (height, width))
        beside = np.eye(4)
        beside[:3, :3] = cameras.matrix(f"R_{camera}", 3, 3)
        beside[:3, 3] = cameras.matrix(f"T_{camera}", 1, 3)[0]
        matrix, to_camera = (
            cameras.matrix(f"K_{camera}", 3, 3),
            np.vstack([to_camera, np.eye(4)[3]]),
        )
        distortion = cameras.matrix(f"D_{camera}", 1, 5)[0].tolist()
        size = height, width
        return cls(matrix, beside @ to_camera, size, lens=PLUMB_BOB, distortion=distortion)

    @classmethod
    def from_camera_info(
        cls, info: Mapping[str, Any], extrinsics: Any, *, rectified: bool, size: Size | None = None
    ) -> "Calibration":
        """Take the fields of a ROS CameraInfo.

        Args:
            info: "p" or "P" (12 numbers), "k" or "K" (9), "d" or "D", "distortion_model", "height"
                and "width", and, if set, "binning_x", "binning_y" and "roi", a mapping.
            extrinsics: (4, 4) from the LiDAR's frame to the camera's optical frame, as in tf; if P
                holds a baseline, to the frame of the stereo pair's first camera.
            rectified: True for the images of image_rect, which P describes; False for those of
                image_raw, which K and D describe. If only one of K and P is not zero, that one is
                used.
            size: (height, width) of the images; None: the CameraInfo decides, see
                `region_of_images`.

        Raises:
            InputError: if fields are missing, or the distortion model is not a known `lens`.
        """
        fields = {str(key).lower(): value for key, value in info.items()}
        distortion = fields.get("d", ())
        lens = None if rectified else Lens.of_ros(fields.get("distortion_model"), distortion)
        projection = finite_matrix("P of the CameraInfo", fields.get("p", [0] * 12), 3, 4)
        shift = np.eye(4)
        if projection.any() and (rectified or not np.any(fields.get("k", 0))):
            intrinsics, shift = split_projection(projection, "P of the CameraInfo")
        elif "k" in fields:
            intrinsics = finite_matrix("K of the CameraInfo", fields["k"], 3, 3)
            if rectified and np.any(distortion):
                raise InputError(
                    "the CameraInfo has distortion but no P of rectified images: give the P of "
                    "image_proc, or rectified=False with the raw images"
                )
        else:
            raise InputError("the CameraInfo has neither p nor k: give its fields as a mapping")
        intrinsics, size = region_of_images(fields, intrinsics, size)
        to_camera = shift @ finite_matrix("extrinsics", extrinsics, 4, 4)
        model, distortion = (None, None) if lens is None else (lens.model, lens.coefficients)
        return cls(intrinsics, to_camera, size, lens=model, distortion=distortion)

    @classmethod
    def from_toml(cls, path: Path | str) -> "Calibration":
        """Read a TOML file.

        Args:
            path: the file. It has `intrinsics` (3 rows of 3) and `extrinsics` (4 rows of 4) or, if
                the points are in the camera's frame, `points_in = "camera"`. It may have `size`
                ([height, width]), `lens` with `distortion`, and `body_from_lidar` (4 rows of 4).

        Raises:
            InputError: if the file cannot be read, or if a key is unknown or missing.
        """
        keys = read_toml(Path(path))
        in_camera = keys.get("points_in") == "camera"
        needed = {"intrinsics", "points_in" if in_camera else "extrinsics"}
        if keys.keys() - {"size", "body_from_lidar", "lens", "distortion"} != needed:
            raise InputError(
                f"{path} has the keys {', '.join(sorted(keys)) or 'none'}, expected intrinsics, "
                'extrinsics (or points_in = "camera") and optionally size, lens with distortion, '
                "and body_from_lidar"
            )
        size, body = keys.get("size"), keys.get("body_from_lidar")
        return cls(
            finite_matrix(f"intrinsics of {path}", keys["intrinsics"], 3, 3),
            finite_matrix(f"extrinsics of {path}", keys.get("extrinsics", np.eye(4)), 4, 4),
            tuple(size) if isinstance(size, list) else size,
            body_from_lidar=None if body is None else finite_matrix(f"body of {path}", body, 4, 4),
            lens=keys.get("lens"),
            distortion=keys.get("distortion"),
        )


def find_raw_calibration(drive: Path) -> Path | None:
    """Return the folder of KITTI raw data's calibration, `drive` or its parent, or None."""
    folders = (drive, Path(os.path.realpath(drive)).parent)
    return next((each for each in folders if os.path.exists(each / RAW_CAMERAS)), None)
