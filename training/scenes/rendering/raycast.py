"""Ray casting with Embree: first hits, their surfaces, and occlusion."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from training.scenes.arrays import Floats, Rows
from training.scenes.textures.patterns import Stripe
from training.scenes.textures.surface import Points, Surface, SurfaceKind
from training.scenes.textures.surfaces import texture_surfaces
from training.scenes.things.mesh import Mesh, face_normals


@dataclass(frozen=True)
class Hits(Rows):
    """First hits of rays.

    Attributes:
        distance: (n,), in multiples of the direction.
        face: int32 (n,), -1 = none.
        u, v: (n,), barycentric weights of the second and third corner.
    """

    distance: Floats
    face: NDArray[np.int32]
    u: Floats
    v: Floats


class RayCaster:
    """Casts rays against a mesh with paint on its road."""

    def __init__(self, mesh: Mesh, stripes: tuple[Stripe, ...] = ()) -> None:
        self.mesh, self._stripes, self._scene = mesh, stripes, EmbreeScene()
        positions = np.ascontiguousarray(mesh.positions, dtype=np.float32)
        self._triangles = TriangleMesh(self._scene, positions)  # must live as long as the scene

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first hits of rays (n, 3)."""
        rays = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        found = self._scene.run(*rays, output=True)
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def blocked(self, origins: Floats, directions: Floats, reach: float = 1e4) -> NDArray[np.bool_]:
        """Return whether each ray is blocked within reach."""
        if not len(origins):
            return np.zeros(0, dtype=bool)
        rays = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        limit = np.full(len(origins), reach, dtype=np.float32)
        return np.asarray(np.not_equal(self._scene.run(*rays, limit, query="OCCLUDED"), -1))

    def normals(self, hits: Hits, view: Floats) -> Floats:
        """Return normals (n, 3) of the faces that were hit, turned against the direction `view`."""
        flat = face_normals(self.mesh.positions[hits.face])
        toward = (flat * view).sum(1, keepdims=True)
        return np.asarray(flat * np.where(toward > 0, np.float32(-1), np.float32(1)))

    def surfaces(self, hits: Hits, view: Floats, footprint: Floats) -> tuple[Points, Surface]:
        """Return what rays along unit vectors `view` (n, 3) hit; none of them may miss.

        `footprint`, (n,), is the width [m] that a ray covers there.
        """
        mesh, face = self.mesh, hits.face
        u, v = hits.u[:, None], hits.v[:, None]

        def interpolate(corners: Floats) -> Floats:
            picked = corners[face]
            return np.asarray(picked[:, 0] * (1 - u - v) + picked[:, 1] * u + picked[:, 2] * v)

        normal = interpolate(mesh.normals)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9
        flat = self.normals(hits, view)
        turn = ((normal * flat).sum(1) < 0) & (mesh.kind[face] != SurfaceKind.FOLIAGE)
        normal[turn] = -normal[turn]
        slant = np.abs((flat * view).sum(1))
        texture, color, params = interpolate(mesh.texture), mesh.color[face], mesh.params[face]
        points = Points(texture, normal, color, params, footprint, slant)
        return points, texture_surfaces(mesh.kind[face], points, self._stripes)
