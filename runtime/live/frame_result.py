"""What a stream gives back for a frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.health.consistency import Consistency
from runtime.prediction import Prediction
from runtime.sync.stamp import Stamp


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The answer to one image and the depth map that was matched with it.

    sequence: 0 for the stream's first answer, and so on
    rgb: uint8 (H, W, 3), the image
    health: what is wrong with the sensors, besides `prediction.degraded`: "image_frozen",
        "image_black", "image_overexposed", "lidar_sector_lost", "lidar_lines_lost"; () if nothing
    consistency: running figures of how well camera and LiDAR fit; None unless the stream was asked
        for them, and in answers from the camera alone
    image_stamp, depth_stamp: as they were pushed; depth_stamp is None where the answer comes from
        the camera alone (`prediction.degraded` then holds "no_depth")
    skew_ms: depth stamp - image stamp
    latency_ms: until the answer was there; live: since the image was pushed, waiting for its depth
        and for its turn included; replayed: since its turn came
    age_ms: time of the answer - stamp of the image, by the sensors' clock; where that is not known,
        since the image was pushed; None in a replay without such a clock
    deadline_met: whether latency_ms is within the deadline; None without one
    """

    sequence: int
    rgb: NDArray[np.uint8]
    prediction: Prediction
    health: tuple[str, ...]
    consistency: Consistency | None
    image_stamp: Stamp
    depth_stamp: Stamp | None
    skew_ms: float | None
    latency_ms: float
    age_ms: float | None
    deadline_met: bool | None
