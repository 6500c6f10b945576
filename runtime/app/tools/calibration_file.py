"""A calibration as text: the TOML file that the commands read, and the transform of ROS."""

import numpy as np
from numpy.typing import NDArray

from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import quaternion_of


def format_toml(calibration: Calibration, *comments: str) -> str:
    """Return the content of a file for --calibration, see `Calibration.from_toml`."""
    lines = [f"# {line}" for comment in comments for line in comment.splitlines()]
    for name in ("intrinsics", "extrinsics", "body_from_lidar"):
        if (matrix := getattr(calibration, name)) is not None:
            rows = ",\n".join(f"  {row}" for row in matrix.tolist())
            lines.append(f"{name} = [\n{rows},\n]")
    if calibration.size is not None:
        lines.append(f"size = {list(calibration.size)}")
    if calibration.lens is not None and calibration.distortion is not None:
        lines.append(f'lens = "{calibration.lens}"')
        lines.append(f"distortion = {[float(each) for each in calibration.distortion]}")
    return "\n".join(lines) + "\n"


def format_static_transform(
    rotation: NDArray[np.float64], position: NDArray[np.float64], frames: tuple[str, str]
) -> str:
    """Return the command of ROS 2 that publishes the LiDAR's place in the camera's frame.

    Args:
        rotation: float64 (3, 3), from the LiDAR's axes to the camera's.
        position: float64 (3,), position of the LiDAR in the camera's frame, metres.
        frames: names of the frames of camera and LiDAR.
    """
    values = zip(("x", "y", "z"), position, strict=True)
    turns = zip(("qw", "qx", "qy", "qz"), quaternion_of(rotation), strict=True)
    numbers = " ".join(f"--{name} {value:.9g}" for name, value in (*values, *turns))
    camera, lidar = frames
    return (
        f"ros2 run tf2_ros static_transform_publisher {numbers} --frame-id {camera} "
        f"--child-frame-id {lidar}"
    )
