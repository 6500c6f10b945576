"""The answer to a frame, and the result of a live stream for it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.health.consistency import Consistency
from runtime.prediction import Prediction
from runtime.sync.depth_in_time import DepthMotion
from runtime.sync.stamp import Stamp


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameAnswer:
    """The prediction for one image and the depth map that was matched with it.

    Attributes:
        rgb: uint8 (H, W, 3), the image.
        prediction: of the `Predictor`.
        health: what is wrong with the sensors, see `FrameHealth.check`; () if nothing.
        consistency: running figures of calibration and sync; None without the option `consistency`,
            and where the prediction is from the camera alone.
        image_stamp, depth_stamp: as given; depth_stamp is None where the prediction is from the
            camera alone (`prediction.degraded` then holds "no_depth").
        skew_ms: depth stamp - image stamp; None without depth.
        depth_reused: whether the depth is an older scan's (`prediction.degraded` then holds
            "depth_reused"), because the image has none of its own.
        depth_motion: "each" where each return was moved to the time of the image by its own time,
            "scan" where the scan was moved as one, "none" where it is as it was measured; None
            without depth.
    """

    rgb: NDArray[np.uint8]
    prediction: Prediction
    health: tuple[str, ...]
    consistency: Consistency | None
    image_stamp: Stamp
    depth_stamp: Stamp | None
    skew_ms: float | None
    depth_reused: bool
    depth_motion: DepthMotion | None

    @property
    def depth_age_ms(self) -> float | None:
        """Image stamp - depth stamp; None without depth."""
        return None if self.skew_ms is None else 0.0 - self.skew_ms  # no -0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameResult(FrameAnswer):
    """The answer of a live stream to a frame, and when it came.

    Attributes:
        sequence: 0 for the first result of the stream, and so on.
        latency_ms: since the image was pushed, with waiting for its depth and for its turn.
        age_ms: time of the result - stamp of the image, by `sensor_clock`; without one
            `latency_ms`.
        deadline_met: whether latency_ms is within the deadline; None without one.
    """

    sequence: int
    latency_ms: float
    age_ms: float
    deadline_met: bool | None
