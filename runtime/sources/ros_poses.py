"""Poses and times of points from deserialised ROS messages."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.poses import pose_of

#: Field of a PointCloud2 with the time of each point, as drivers name it; the first that is there.
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
#: Datatype of such a field -> NumPy's type and the nanoseconds of its unit.
_TIMES: dict[int, tuple[str, float]] = {
    6: ("u4", 1.0),
    5: ("i4", 1.0),
    7: ("f4", 1e9),
    8: ("f8", 1e9),
}
_LONGEST_SCAN_NS = 1e9


def odometry_pose(message: Any) -> NDArray[np.float64]:
    """Return the pose float64 (4, 4) of a nav_msgs/Odometry: of `child_frame_id` in its frame.

    Raises:
        InputError: if the quaternion is not of unit length, or a number is not finite.
    """
    return _pose(message.pose.pose.position, message.pose.pose.orientation, "an Odometry")


def transform_pose(stamped: Any) -> NDArray[np.float64]:
    """Return the pose float64 (4, 4) of a geometry_msgs/TransformStamped of /tf.

    It is that of `child_frame_id` in the frame of its header.

    Raises:
        InputError: as `odometry_pose`.
    """
    transform = stamped.transform
    return _pose(transform.translation, transform.rotation, "a TransformStamped")


def point_times_ns(message: Any, stamp_ns: int) -> NDArray[np.int64] | None:
    """Return when each point of a PointCloud2 was measured, nanoseconds of the stamp's clock.

    Integers are nanoseconds and floats seconds. Four bytes are after the stamp; eight are of the
    clock where they are too large to be after the stamp.

    Args:
        message: sensor_msgs/PointCloud2.
        stamp_ns: of its header.

    Returns:
        int64 (N,), None where it has no such field, or the same time for all points.

    Raises:
        InputError: for a field of another type or beyond a point, and for truncated data.
    """
    field = next((f for name in TIME_FIELDS for f in message.fields if f.name == name), None)
    if field is None:
        return None
    height, width = int(message.height), int(message.width)
    step, row_step = int(message.point_step), int(message.row_step)
    if field.datatype not in _TIMES or field.count not in (0, 1):
        raise InputError(
            f"the field {field.name} of a PointCloud2 has the datatype {field.datatype}, expected "
            "int32 or uint32 [ns], or float32 or float64 [s]"
        )
    code, unit_ns = _TIMES[field.datatype]
    dtype = np.dtype(("<", ">")[bool(message.is_bigendian)] + code)
    offset = int(field.offset)
    data = np.frombuffer(memoryview(message.data), np.uint8)
    row_step = row_step if height > 1 else width * step
    if not height * width:
        return None
    needed = row_step * (height - 1) + width * step
    if (
        offset < 0
        or offset + dtype.itemsize > step
        or row_step < width * step
        or needed > len(data)
    ):
        raise InputError(
            f"a PointCloud2 of {height} x {width} points of {step} bytes has {len(data)} bytes and "
            f"the field {field.name} at byte {offset}: it is truncated or inconsistent"
        )
    times = np.ndarray((height, width), dtype, data, offset, (row_step, step)).ravel()
    values = np.asarray(times, np.float64) * unit_ns
    if not np.isfinite(values).all():
        raise InputError(f"the field {field.name} of a PointCloud2 holds NaN or infinity")
    if values.min() == values.max():
        return None  # drivers that do not fill it
    if dtype.itemsize == 8 and np.abs(values).max() > _LONGEST_SCAN_NS:
        whole = np.floor(times).astype(np.int64)  # not by one float64, which would lose digits
        absolute: NDArray[np.int64] = whole * 10**9 + np.rint((times - whole) * 1e9).astype(
            np.int64
        )
        return absolute
    return stamp_ns + np.rint(values).astype(np.int64)


def _pose(position: Any, quaternion: Any, name: str) -> NDArray[np.float64]:
    return pose_of(
        (position.x, position.y, position.z),
        (quaternion.x, quaternion.y, quaternion.z, quaternion.w),
        name,
    )
