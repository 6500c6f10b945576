"""A frame that a source read."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.io.calibration import Calibration
from runtime.sync.motion import DepthMotion


@dataclass(frozen=True, eq=False)
class Frame:
    """An image with its sparse depth map.

    Attributes:
        rgb: uint8 (H, W, 3), RGB.
        sparse_depth: float32 (H, W), metres along the optical axis, 0 where there is no return.
        image_stamp_ns: time of the image by its sensor's clock [ns], None if unknown.
        depth_stamp_ns: the same of the depth; None without depth.
        calibration: of the camera and the LiDAR, None if unknown.
        focal_length_px: fx for its prediction, None if unknown; a run sets it.
        name: of the frame in its stream; a run sets it.
        health: what `runtime.health` found in the frame; a run sets it.
        depth_reused: whether the depth is an older scan's.
        depth_motion: as of `DepthInTime`; None without depth.
        degraded: reasons that reading found, as of `Prediction.degraded`.
        lost_points: as of `Cleaned`.

    Raises:
        InputError: if the calibration is of images of another size.
    """

    rgb: NDArray[np.uint8]
    sparse_depth: NDArray[np.float32]
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    calibration: Calibration | None = None
    focal_length_px: float | None = None
    name: str = ""
    health: tuple[str, ...] = ()
    depth_reused: bool = False
    depth_motion: DepthMotion | None = None
    degraded: tuple[str, ...] = ()
    lost_points: int = 0

    def __post_init__(self) -> None:
        """Check the size, which would silently falsify clouds and the focal length."""
        if self.calibration is not None:
            self.calibration.require_size(self.rgb.shape[:2])
