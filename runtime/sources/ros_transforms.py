"""Poses of the frames of a robot: the tree of /tf_static."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.checks import cut, shown
from runtime.errors import InputError
from runtime.sources.ros_messages import frame_name
from runtime.sources.ros_poses import transform_pose


class TransformTree:
    """Transforms between frames; the last one of a child counts.

    Args:
        messages: tf2_msgs/TFMessage.

    Raises:
        InputError: for an invalid rotation and for numbers that are not finite.
    """

    def __init__(self, messages: Iterable[Any]) -> None:
        self._parents: dict[str, tuple[str, NDArray[np.float64]]] = {}
        for message in messages:
            for stamped in message.transforms:
                parent = frame_name(stamped.header.frame_id)
                self._parents[frame_name(stamped.child_frame_id)] = parent, transform_pose(stamped)

    def between(self, source: str, target: str) -> NDArray[np.float64]:
        """Return the matrix, float64 (4, 4), from the frame `source` to the frame `target` [m].

        Raises:
            InputError: if the two are not connected.
        """
        from_source = self._ancestors(frame_name(source))
        from_target = self._ancestors(frame_name(target))
        common = next((frame for frame in from_source if frame in from_target), None)
        if common is None:
            frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
            raise InputError(
                f"/tf_static does not connect the frame {shown(source)} to {shown(target)}, it has "
                f"{cut(', '.join(sorted(frames)), 300) or 'no frames'}: give --calibration"
            )
        matrix: NDArray[np.float64] = np.linalg.inv(from_target[common]) @ from_source[common]
        matrix[3] = (0, 0, 0, 1)  # to the last bit
        return matrix

    def carriers(self, frame: str) -> list[str]:
        """A frame and the frames that it is fixed to, the nearest first."""
        return list(self._ancestors(frame_name(frame)))

    def _ancestors(self, frame: str) -> dict[str, NDArray[np.float64]]:
        """Each ancestor and the matrix from `frame` to it, the nearest first."""
        matrices = {frame: np.eye(4)}
        matrix = np.eye(4)
        while frame in self._parents:
            frame, to_parent = self._parents[frame]
            if frame in matrices:
                raise InputError(f"/tf_static has a cycle at the frame {shown(frame)}")
            matrix = to_parent @ matrix
            matrices[frame] = matrix
        return matrices
