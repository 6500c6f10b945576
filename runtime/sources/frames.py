"""A frame that a source read."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.io.calibration import Calibration


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture, uint8 (H, W, 3), and its sparse depth map, float32 (H, W) [m], 0 = no return.

    image_stamp_ns, depth_stamp_ns: when the sensors took them, by their own clock [ns]; None where
        that is not known, and where there is no depth
    calibration: of the camera, and of the LiDAR to it; None = not known
    name: of the frame in its stream; a run sets it
    health: what `runtime.health` found in the frame; a run sets it
    Raises InputError for a calibration of pictures of another size.
    """

    rgb: NDArray[np.uint8]
    sparse_depth: NDArray[np.float32]
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    calibration: Calibration | None = None
    name: str = ""
    health: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check what a cloud and the focal length would silently get wrong."""
        if self.calibration is not None:
            self.calibration.require_size(self.rgb.shape[:2])
