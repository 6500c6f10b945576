"""Embree behind two questions: what does a ray hit first, and is anything in its way."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from training.scenes.arrays import Floats


@dataclass(frozen=True)
class Hits:
    """First hits: distance (n,) in multiples of the direction, face (n,) int32 (-1 = none),
    u and v (n,): barycentric weights of the second and third corner."""

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
        """What rays (n, 3) hit first."""
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=True
        )
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def blocked(self, origins: Floats, directions: Floats, reach: float = 1e4) -> NDArray[np.bool_]:
        """Whether anything lies on each ray within reach."""
        if not len(origins):
            return np.zeros(0, dtype=bool)
        limit = np.full(len(origins), reach, dtype=np.float32)
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), limit, query="OCCLUDED"
        )
        return np.asarray(np.not_equal(found, -1))
