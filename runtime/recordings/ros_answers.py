"""Answers as the fields of ROS's standard messages, for files and for nodes.

Each function returns the fields of a message, without its header, by their names in ROS 2.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.geometry.calibration import Calibration
from runtime.geometry.point_cloud import PointCloud
from runtime.geometry.poses import quaternion_of
from runtime.streams.frame_result import FrameResult
from runtime.streams.stream_counter import WatchdogLevel, WatchdogState

# Datatypes of sensor_msgs/PointField for NumPy's types.
_DATATYPES = {"|u1": 2, "<u4": 6, "<f4": 7}
# The states of a stream by the levels of diagnostic_msgs/DiagnosticStatus, 0 to 3.
_LEVELS = [WatchdogLevel.OK, WatchdogLevel.WARN, WatchdogLevel.ERROR, WatchdogLevel.NOT_YET]


class FixedTransform(NamedTuple):
    """A transform of /tf_static.

    Attributes:
        parent: the parent frame.
        child: the frame that the transform places in the parent.
        translation: x, y, z of the child's origin in the parent [m].
        rotation: unit quaternion x, y, z, w.
    """

    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    @classmethod
    def of(cls, parent: str, child: str, pose: NDArray[np.float64]) -> "FixedTransform":
        """Return the transform of a pose, float64 (4, 4), from the child to the parent [m]."""
        x, y, z = pose[:3, 3].tolist()
        w, *turn = quaternion_of(pose[:3, :3]).tolist()
        return cls(parent, child, (x, y, z), (turn[0], turn[1], turn[2], w))


class SensorFrames(NamedTuple):
    """Where a recording's sensors are, in the terms of ROS.

    Attributes:
        camera: frame id of the answers.
        transforms: the fixed transforms between frames.
        origin: what states the transforms, in words; "" if there are none.
    """

    camera: str = "camera"
    transforms: tuple[FixedTransform, ...] = ()
    origin: str = ""

    @classmethod
    def of(
        cls, calibration: Calibration | None, camera: str = "camera", lidar: str = "lidar"
    ) -> "SensorFrames":
        """Return the frames of a recording whose LiDAR only a calibration places."""
        if calibration is None:
            return cls()
        place = FixedTransform.of(camera, lidar, calibration.extrinsics)
        return cls(camera, (place,), "the calibration")


def cloud_fields(cloud: PointCloud) -> dict[str, Any]:
    """Return the fields of a PointCloud2: x, y, z, rgb, class, uncertainty, without padding.

    Colours are packed as PCL packs them: 0x00RRGGBB in the bits of a float32.
    """
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", cloud.points.T, strict=True))
    if cloud.rgb is not None:
        red, green, blue = cloud.rgb.astype(np.uint32).T
        columns["rgb"] = ((red << 16) | (green << 8) | blue).view(np.float32)
    if cloud.semantic is not None:
        columns["class"] = cloud.semantic
    if cloud.uncertainty is not None:
        columns["uncertainty"] = cloud.uncertainty
    kinds = [(name, each.dtype) for name, each in columns.items()]
    points: Any = np.rec.fromarrays(list(columns.values()), dtype=kinds)
    fields = [
        {"name": name, "offset": offset, "datatype": _DATATYPES[kind.str], "count": 1}
        for name, (kind, offset) in points.dtype.fields.items()
    ]
    return {
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": points.itemsize,
        "row_step": points.nbytes,
        "data": points.view(np.uint8),
        "is_dense": True,
    }


def camera_fields(camera: Calibration, size: tuple[int, int]) -> dict[str, Any]:
    """Return the fields, except `roi`, of a CameraInfo for images of this size (height, width)."""
    matrix, lens = np.asarray(camera.intrinsics, np.float64), camera.lens_model
    return {
        "height": size[0],
        "width": size[1],
        "distortion_model": "plumb_bob" if lens is None else lens.model,
        "d": np.zeros(5) if lens is None else np.array(lens.coefficients, np.float64),
        "k": matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.hstack([matrix, np.zeros((3, 1))]).ravel(),
        "binning_x": 0,
        "binning_y": 0,
    }


def status_fields(
    result: FrameResult | None = None, state: WatchdogState | None = None
) -> dict[str, Any]:
    """Return the fields of a diagnostic_msgs/DiagnosticStatus except its names.

    Args:
        result: an answer; if it is degraded or unhealthy, the level is a warning.
        state: state of a stream; its level counts if it is worse.

    Returns:
        `level`, 0 to 3; `message`; and `values`, a mapping of texts.
    """
    level, reasons, values = WatchdogLevel.OK, list[str](), {}
    if result is not None:
        prediction = result.prediction
        reasons += [*prediction.degraded, *result.health]
        level = WatchdogLevel.WARN if reasons else WatchdogLevel.OK
        values = {
            "frame": result.name,
            **{stage: f"{ms:.3f}" for stage, ms in vars(prediction.latency).items()},
            "depth_returns": str(prediction.depth_returns),
            "memory_returns": str(result.memory_returns),
            "memory_off": result.memory_off,
            "depth_cleaned": str(prediction.cleaned.total),
        }
    if state is not None:
        level = max(level, state.level, key=_LEVELS.index)
        reasons += [reason for reason in state.reasons if reason not in reasons]
        values["state"] = str(state.level)
    return {"level": _LEVELS.index(level), "message": ", ".join(reasons) or "ok", "values": values}
