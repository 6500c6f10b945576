"""Poses of the frames of a robot: the tree of /tf_static."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError


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
                child, parent = (
                    frame_name(stamped.child_frame_id),
                    frame_name(stamped.header.frame_id),
                )
                self._parents[child] = (parent, _matrix(stamped.transform, f"{parent} to {child}"))

    def between(self, source: str, target: str) -> NDArray[np.float64]:
        """Return the matrix, float64 (4, 4), from the frame `source` to the frame `target` [m].

        Raises:
            InputError: if the two are not connected.
        """
        from_source, from_target = (
            self._ancestors(frame_name(source)),
            self._ancestors(frame_name(target)),
        )
        common = next((frame for frame in from_source if frame in from_target), None)
        if common is None:
            frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
            raise InputError(
                f"/tf_static does not connect the frame {source!r:.80} to {target!r:.80}, it has "
                f"{', '.join(sorted(frames)) or 'no frames':.300}: give --calibration"
            )
        matrix: NDArray[np.float64] = np.linalg.inv(from_target[common]) @ from_source[common]
        matrix[3] = (0, 0, 0, 1)  # to the last bit
        return matrix

    def carriers(self, frame: str) -> list[str]:
        """A frame and those that it is fixed to, the nearest first."""
        return list(self._ancestors(frame_name(frame)))

    def _ancestors(self, frame: str) -> dict[str, NDArray[np.float64]]:
        """Each ancestor and the matrix from `frame` to it, the nearest first."""
        matrices = {frame: np.eye(4)}
        matrix = np.eye(4)
        while frame in self._parents:
            frame, to_parent = self._parents[frame]
            if frame in matrices:
                raise InputError(f"/tf_static has a cycle at the frame {frame!r:.80}")
            matrix = to_parent @ matrix
            matrices[frame] = matrix
        return matrices


def frame_name(frame: Any) -> str:
    """Without the slash that ROS 1 wrote in front of some frames."""
    return str(frame).removeprefix("/")


def _matrix(transform: Any, name: str) -> NDArray[np.float64]:
    """The matrix of a geometry_msgs/Transform."""
    q, shift = transform.rotation, transform.translation
    x, y, z, w = quaternion = np.array([q.x, q.y, q.z, q.w], np.float64)
    matrix = np.eye(4)
    matrix[:3, 3] = (shift.x, shift.y, shift.z)
    norm = quaternion @ quaternion
    if not (np.isfinite(matrix).all() and 0.9 < norm < 1.1):
        raise InputError(
            f"the transform from {name} in /tf_static has the rotation {quaternion.tolist()} and "
            f"the translation {matrix[:3, 3].tolist()}: expected a unit quaternion and metres"
        )
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix[:3, :3] += 2 / norm * (w * cross + cross @ cross)
    return matrix
