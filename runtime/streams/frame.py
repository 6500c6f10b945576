"""The frame that is made of an image and its depth, at the time of the image."""

import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.contract.degraded import DEPTH_REUSED, DEPTH_UNCOMPENSATED, POINTS_UNTIMED
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import DepthMotion, project_compensated
from runtime.geometry.poses import NoPoseError, PoseTrack
from runtime.streams.memory import Remembered
from runtime.streams.messages import Depth, Image, Scan


class CompensatedDepth(NamedTuple):
    """A sparse depth map.

    Attributes:
        sparse_depth: float32 (H, W), metres, 0 = no return.
        motion: "each" if each return was moved by its own time, "scan" if the scan was moved as a
            whole, "none" if it was not moved.
        degraded: reasons as in `Prediction.degraded`.
        lost_points: see `Cleaned`.
    """

    sparse_depth: NDArray[np.float32]
    motion: DepthMotion
    degraded: tuple[str, ...]
    lost_points: int = 0


@dataclass(frozen=True, eq=False)
class Frame:
    """An image, its depth, and the calibration and poses that move the depth into the image.

    Making a frame moves and projects its scan.

    Attributes:
        image: the image.
        depth: depth map or scan; None: there is no depth.
        reused: whether the depth is an older message, whose outcome is counted elsewhere.
        calibration: calibration of the camera and, for a scan, of the LiDAR; None: not known.
        poses: poses of the LiDAR over the time of the frame; None if the car has no poses.
        name: name of the frame in its recording.
        compensated: the depth at the time of the image; a scan is moved and projected, a map is
            unchanged.
        remembered: what a memory adds to the returns; None without one.

    Raises:
        InputError: if a scan has no calibration, or one of images of another size.
    """

    image: Image
    depth: Depth | Scan | None = None
    reused: bool = False
    calibration: Calibration | None = None
    poses: PoseTrack | None = None
    name: str = ""
    compensated: CompensatedDepth = field(init=False)
    remembered: Remembered | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Move and project the scan."""
        object.__setattr__(self, "compensated", _compensate(self))

    @property
    def own_depth(self) -> Depth | Scan | None:
        """The depth message that shares the outcome of the image; None if the depth is reused."""
        return None if self.reused else self.depth

    @property
    def scan(self) -> Scan | None:
        """The depth if it is a scan, also a reused one."""
        return self.depth if isinstance(self.depth, Scan) else None

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """The image: uint8 (H, W, 3), RGB."""
        return self.image.rgb

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return self.rgb.shape[0], self.rgb.shape[1]

    @property
    def sparse_depth(self) -> NDArray[np.float32]:
        """The returns in the image: float32 (H, W), metres along the optical axis, 0 = none."""
        return self.compensated.sparse_depth

    @property
    def depth_motion(self) -> DepthMotion | None:
        """How the returns were moved, see `CompensatedDepth`; None if there is no depth."""
        return None if self.depth is None else self.compensated.motion

    @property
    def degraded(self) -> tuple[str, ...]:
        """Faults of the depth: reasons for `Prediction.degraded`."""
        return self.compensated.degraded

    def with_remembered(self, remembered: Remembered) -> "Frame":
        """Return the frame with what a memory adds; its own returns remain what was measured."""
        frame = copy.copy(self)
        object.__setattr__(frame, "remembered", remembered)
        return frame

    def fed(self, own: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what is fed if `own`, (H, W), are the returns; nothing is added to none."""
        if self.remembered is None or not self.remembered.returned or not own.any():
            return own
        further = self.remembered.returns
        return np.where(further > 0, further, own)


def _compensate(frame: Frame) -> CompensatedDepth:
    depth, poses, calibration, size = frame.depth, frame.poses, frame.calibration, frame.size
    if depth is None:
        return CompensatedDepth(np.zeros(size, np.float32), "none", ())
    reasons: tuple[str, ...] = (DEPTH_REUSED,) if frame.reused else ()
    if isinstance(depth, Depth):
        is_apart = poses is not None and depth.stamp_ns != frame.image.stamp_ns
        reasons += (DEPTH_UNCOMPENSATED,) if frame.reused or is_apart else ()
        return CompensatedDepth(depth.sparse_depth, "none", reasons)
    if calibration is None:
        raise InputError("a scan cannot be projected without a calibration")
    points, times = depth.points, depth.times
    reasons += (POINTS_UNTIMED,) if depth.untimed else ()
    if poses is not None and times is not None:
        try:
            to_ns = frame.image.time_ns
            moved = project_compensated(calibration, points, times, poses, to_ns, size)
            motion: DepthMotion = "scan" if isinstance(times, int) else "each"
            return CompensatedDepth(moved, motion, reasons, depth.lost)
        except NoPoseError as error:
            reasons += (DEPTH_UNCOMPENSATED, error.reason)
    elif frame.reused:
        reasons += (DEPTH_UNCOMPENSATED,)
    return CompensatedDepth(calibration.project(points, size), "none", reasons, depth.lost)
