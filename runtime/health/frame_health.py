"""All checks of the sensors' data of a frame."""

import numpy as np
from numpy.typing import NDArray

from runtime.contract import MAX_RETURN_M
from runtime.health.image_health import ImageHealth
from runtime.health.lidar_health import LidarHealth


class FrameHealth:
    """Check one frame of a stream after another against the frames before it.

    Not thread-safe.
    """

    def __init__(self) -> None:
        self._image, self._lidar = ImageHealth(), LidarHealth()

    def check(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        *,
        range_m: float = MAX_RETURN_M,
    ) -> tuple[str, ...]:
        """Return what is wrong with the sensors.

        Args:
            rgb: uint8 (H, W, 3); it is kept until the next frame and must not be written to.
            sparse_depth: float32 (H, W), metres, 0 = no return. A map without any return is not
                checked: `Prediction.degraded` reports it.
            range_m: depth range of the frame; farther depths than `farthest_return` are no returns.

        Returns:
            Of "image_frozen", "image_black", "image_overexposed", "lidar_sector_lost" and
            "lidar_lines_lost"; () if nothing is wrong.
        """
        return self._image.check(rgb) + self._lidar.check(sparse_depth, range_m=range_m)
