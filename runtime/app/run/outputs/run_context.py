"""What the outputs of a run share while it is open."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.app.run.options import RunOptions
from runtime.app.run.run_report import RunReport
from runtime.contract.heads import Unit
from runtime.drawing.encode import count_beyond_png
from runtime.drawing.overlay import Overlay
from runtime.engine.prediction import Prediction
from runtime.engine.predictor import Predictor
from runtime.geometry.calibration import Calibration
from runtime.geometry.point_cloud import PointCloud
from runtime.recordings.ros_answers import SensorFrames
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult


@dataclass
class RunContext:
    """A run of one camera while it is open, with all that an output may need.

    Attributes:
        options: options of the run.
        predictor: predictor of the run.
        kinds: the files to write for each frame, some of SUFFIXES.
        names: names of the frames.
        sensors: frames of the camera and the LiDAR, as ROS names them.
        beyond_png: for each kind of file, the number of pixels that its PNGs cannot hold, see
            `count_beyond_png`.
        report: the report, set after the last frame, before the outputs are closed.
    """

    options: RunOptions
    predictor: Predictor
    kinds: Sequence[str] = ()
    names: Sequence[str] = ()
    sensors: SensorFrames = field(default_factory=SensorFrames)
    beyond_png: Counter[str] = field(default_factory=Counter)
    report: RunReport = field(init=False)

    def draw(
        self, frame: Frame, result: FrameResult, *, widest: int | None = None
    ) -> NDArray[np.uint8]:
        """Draw a frame and its answers, by default with the width of --overlay-width."""
        widest = self.options.overlay_width or widest
        return self._overlay.draw(frame.rgb, result.prediction, frame.sparse_depth, widest=widest)

    def cloud(
        self, frame: Frame, prediction: Prediction, *, voxel_m: float | None = None
    ) -> PointCloud | None:
        """The cloud of a frame according to the options; None if the camera is unknown.

        `voxel_m` is the side of the cubes in which one point is kept, unless --cloud-voxel is
        given.
        """
        camera = camera_of(frame, self.predictor.focal_length_px)
        if camera is None or prediction.depth is None:
            return None
        most, voxel_m = self.options.max_uncertainty, self.options.cloud_voxel or voxel_m
        return prediction.points(camera, frame.rgb, max_uncertainty=most, voxel_m=voxel_m)

    def count_beyond(self, kind: str, unit: Unit, values: NDArray[Any]) -> None:
        """Count in `beyond_png` the pixels of a head that a PNG of its unit cannot hold."""
        if unit is Unit.METRES:
            self.beyond_png[kind] += count_beyond_png(values)

    @cached_property
    def _overlay(self) -> Overlay:
        contract = self.predictor.contract
        return Overlay(contract.classes, contract.max_depth_m)


def camera_of(frame: Frame, focal_length_px: float | None) -> Calibration | None:
    """The calibration of a frame, else that of a camera with its principal point in the middle.

    The result is None if the focal length is unknown, too.
    """
    if frame.calibration is not None or focal_length_px is None:
        return frame.calibration
    height, width = frame.size
    x, y = (width - 1) / 2, (height - 1) / 2
    matrix = np.array([[focal_length_px, 0, x], [0, focal_length_px, y], [0, 0, 1.0]])
    return Calibration(matrix, np.eye(4))
