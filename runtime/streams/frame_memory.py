"""The memory of a stream: earlier returns of its frames, see `ScanMemory`."""

import numpy as np

from runtime.base.errors import InputError
from runtime.contract.degraded import DEPTH_UNCOMPENSATED
from runtime.engine.prediction import Prediction
from runtime.geometry.poses import NoPoseError
from runtime.streams.frame import Frame
from runtime.streams.memory import ScanMemory


class FrameMemory:
    """Adds earlier returns to frames that have poses, a calibration and depth of their time.

    Args:
        seconds: how long a return is remembered.

    Raises:
        InputError: if `seconds` is out of range.
    """

    def __init__(self, seconds: float) -> None:
        self._memory = ScanMemory(seconds)

    @classmethod
    def of(cls, memory_s: float | None) -> "FrameMemory | None":
        """Return the memory of `Rig.memory_s`; None without one."""
        return cls(memory_s) if memory_s else None

    @property
    def cleared(self) -> dict[str, int]:
        """Why the memory was emptied -> how often."""
        return self._memory.cleared

    def recall(self, frame: Frame) -> Frame:
        """Return a frame with what is remembered, and remember its own returns."""
        calibration, poses, time_ns = frame.calibration, frame.poses, frame.image.stamp_ns
        if calibration is None or poses is None or time_ns is None or frame.depth is None:
            return frame
        if DEPTH_UNCOMPENSATED in frame.degraded:
            return frame
        try:
            (pose,) = poses.at(np.array([time_ns], np.int64))
            return frame.with_remembered(
                self._memory.recall(frame.sparse_depth, pose, time_ns, calibration)
            )
        except InputError as error:
            self._memory.clear(error.reason if isinstance(error, NoPoseError) else str(error))
            return frame

    def answered(self, frame: Frame, prediction: Prediction) -> None:
        """See `ScanMemory.answered`."""
        if frame.remembered is not None:
            self._memory.answered(prediction)
