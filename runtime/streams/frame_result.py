"""The answer of a replay or a live stream to a frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.health.consistency import Consistency
from runtime.prediction import Prediction
from runtime.streams.frame_outcome import FrameOutcome
from runtime.sync.stamp import Stamp


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameResult(FrameOutcome):
    """The answer to one image and the depth map that was matched with it, see `FrameOutcome`.

    Attributes:
        rgb: uint8 (H, W, 3), the image, read-only: the next check predicts from it.
        consistency: running figures of calibration and sync; None without the option `consistency`,
            and where the prediction is from the camera alone.
    """

    rgb: NDArray[np.uint8]
    prediction: Prediction
    consistency: Consistency | None
    image_stamp: Stamp
    latency_ms: float
    age_ms: float
