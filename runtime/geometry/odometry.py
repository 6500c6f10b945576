"""Poses of a LiDAR from its scans alone, by KISS-ICP (Vizzo et al. 2023), the extra `odometry`."""

from typing import Any

import numpy as np

from runtime.base.arrays import Float32, Float64
from runtime.base.errors import InputError, import_remedy
from runtime.geometry.returns import check_points, is_return

# What stands for the file of the poses if they are to be found from the scans.
ODOMETRY = "odometry"


class Odometry:
    """Finds the pose of a LiDAR at each of its scans. Not thread-safe.

    ```python
    odometry = Odometry()
    stream.push_pose(odometry.add(points), stamp)  # with Rig(pose_frame="lidar")
    stream.push_points(points, stamp)
    ```

    Args:
        threads: threads of the registration; more compete with inference.

    Raises:
        InputError: if the package kiss-icp is missing.
    """

    def __init__(self, *, threads: int = 1) -> None:
        try:
            from kiss_icp.config import load_config
            from kiss_icp.kiss_icp import KissICP
        except ImportError as error:
            remedy = import_remedy(error, "odometry")
            raise InputError(f"poses by odometry need kiss-icp ({error}): {remedy}") from error
        config = load_config(None)
        config.data.deskew = False  # returns are moved to the time of their image afterwards
        config.registration.max_num_threads = threads
        self._registration: Any = KissICP(config)

    def add(self, points: Float32) -> Float64:
        """Return the pose of the LiDAR, float64 (4, 4), at the next scan; that of the first is I.

        Args:
            points: float32 (N, 3) or wider: x, y, z in metres in the LiDAR's frame. Points that are
                no returns are left out.

        Raises:
            InputError: if the points are no scan.
        """
        check_points(points)
        returns = points[is_return(points), :3].astype(np.float64)
        if len(returns):  # an empty scan tells nothing: the pose is the last one
            self._registration.register_frame(returns, np.zeros(0))
        return np.array(self._registration.last_pose)
