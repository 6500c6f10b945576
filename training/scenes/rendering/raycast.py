"""Ray casting with Embree: first hits and occlusion."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from training.scenes.arrays import Floats, Rows


@dataclass(frozen=True)
class Hits(Rows):
    """First hits of rays.

    distance: (n,), in multiples of the direction. face: int32 (n,), -1 = none. u, v: (n,),
    barycentric weights of the second and third corner.
    """

    distance: Floats
    face: NDArray[np.int32]
    u: Floats
    v: Floats


class RayCaster:
    """Rays against triangles (n, 3, 3) float32."""

    def __init__(self, positions: Floats) -> None:
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(positions, dtype=np.float32))

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first hits of rays (n, 3)."""
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=True
        )
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def blocked(self, origins: Floats, directions: Floats, reach: float = 1e4) -> NDArray[np.bool_]:
        """Return whether each ray is blocked within reach."""
        if not len(origins):
            return np.zeros(0, dtype=bool)
        limit = np.full(len(origins), reach, dtype=np.float32)
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), limit, query="OCCLUDED"
        )
        return np.asarray(np.not_equal(found, -1))
