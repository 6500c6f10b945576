"""Triangle meshes with the attributes for shading, and basic shapes."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Self, TypeVar

import numpy as np
import trimesh
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from training.scenes.arrays import Floats, Rows
from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind

T = TypeVar("T")
Lattice = ArrayLike | None
# Linear RGB, 0..1.
Color = tuple[float, ...]


def rows(text: str) -> tuple[tuple[float, ...], ...]:
    """Return the rows of a table of numbers: "1 2, 3 4" is ((1, 2), (3, 4))."""
    return tuple(tuple(float(number) for number in row.split()) for row in text.split(","))


def pick(choices: Sequence[T], rng: Generator) -> T:
    """Draw one of the choices."""
    return choices[int(rng.integers(len(choices)))]


def vary(
    colors: Sequence[Color], rng: Generator, *, most: float, tint: float, limits: Sequence[float]
) -> Color:
    """Return a shade of a colour, 0.75 to `most` times as bright, whose channels vary by `tint`."""
    bright = np.asarray(pick(colors, rng)) * rng.uniform(0.75, most)
    tinted = bright * rng.uniform(1 - tint, 1 + tint, 3)
    return tuple(tinted.clip(limits[0], limits[1]).tolist())


@dataclass(frozen=True)
class Look:
    """A material: its kind, base colour (linear RGB 0..1), class and shader parameters."""

    kind: SurfaceKind
    color: Color
    label: SceneClass
    params: tuple[float, ...] = ()


@dataclass(frozen=True)
class Mesh(Rows):
    """Triangles with their attributes.

    Texture coordinates are positions in the object's own frame, so patterns move with the object.

    Attributes:
        positions, normals, texture: (n, 3, 3) float32, triangle x corner x axis; metres.
        color: (n, 3) float32.
        kind, label: (n,) uint8.
        params: (n, 8) float32, read by the shader of the surface kind.
    """

    positions: Floats
    normals: Floats
    texture: Floats
    color: Floats
    kind: NDArray[np.uint8]
    label: NDArray[np.uint8]
    params: Floats

    def moved(self, *, heading: float = 0.0, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Turn by `heading` (rad, about z) and shift by `offset` (m); texture stays."""
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], dtype=np.float32)
        positions = self.positions @ turn + np.asarray(offset, dtype=np.float32)
        return replace(self, positions=positions, normals=self.normals @ turn)

    def scaled(self, factor: float) -> Self:
        """Scale the positions about the origin."""
        return replace(self, positions=self.positions * np.float32(factor))


def join(*meshes: Mesh) -> Mesh:
    """Return one mesh made of several."""
    return Mesh(*(np.concatenate([getattr(m, f.name) for m in meshes]) for f in fields(Mesh)))


def triangles(
    positions: ArrayLike, look: Look, *, normals: Lattice = None, texture: Lattice = None
) -> Mesh:
    """Return a mesh of (n, 3, 3) corners; by default normals are flat and texture = positions."""
    corners = np.asarray(positions, dtype=np.float32).reshape(-1, 3, 3)
    n = len(corners)
    if normals is None:
        normals = np.repeat(face_normals(corners)[:, None], 3, axis=1)
    params = (*look.params, *(0.0,) * (8 - len(look.params)))
    return Mesh(
        corners,
        np.asarray(normals, dtype=np.float32).reshape(-1, 3, 3),
        np.array(corners if texture is None else texture, np.float32).reshape(-1, 3, 3),
        np.tile(np.asarray(look.color, dtype=np.float32), (n, 1)),
        np.full(n, look.kind, dtype=np.uint8),
        np.full(n, look.label, dtype=np.uint8),
        np.tile(np.asarray(params, dtype=np.float32), (n, 1)),
    )


def face_normals(corners: Floats) -> Floats:
    """Unit normals (n, 3) of triangles (n, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12))


def _grid_corners(values: Floats) -> Floats:
    """(a, b, 3) lattice to (2(a-1)(b-1), 3, 3) triangle corners."""
    near, far = values[:-1], values[1:]
    corners = (near[:, :-1], far[:, :-1], far[:, 1:], near[:, :-1], far[:, 1:], near[:, 1:])
    return np.stack(corners, axis=2).reshape(-1, 3, 3)


def grid(points: ArrayLike, look: Look, *, texture: Lattice = None, smooth: bool = False) -> Mesh:
    """Quads over an (a, b, 3) lattice of points; `smooth` averages the normals over the lattice."""
    lattice = np.asarray(points, dtype=np.float64)
    normals = None
    if smooth:
        n = np.cross(*np.gradient(lattice, axis=(0, 1)))
        normals = _grid_corners(n / (np.linalg.norm(n, axis=2, keepdims=True) + 1e-12))
    tex = None if texture is None else _grid_corners(np.asarray(texture, dtype=np.float64))
    return triangles(_grid_corners(lattice), look, normals=normals, texture=tex)


def polygon(corners: ArrayLike, look: Look, *, texture: Lattice = None) -> Mesh:
    """A convex polygon of corners (n, 3), counter-clockwise as seen from its front."""
    points = np.asarray(corners)
    fan = [[0, k, k + 1] for k in range(1, len(points) - 1)]
    tex = None if texture is None else np.asarray(texture)[fan]
    return triangles(points[fan], look, texture=tex)


def box(size: ArrayLike, centre: ArrayLike, look: Look) -> Mesh:
    """Axis-aligned box, size and centre in metres."""
    vertices, faces = _solid()
    return triangles((vertices * np.asarray(size) + np.asarray(centre))[faces], look)


def tube(
    start: ArrayLike,
    end: ArrayLike,
    radii: tuple[float, float],
    look: Look,
    *,
    sides: int = 7,
    rounded: bool = False,
) -> Mesh:
    """Tapered tube from start to end; `rounded` closes it with domes, else with flat lids."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    axis = b - a
    length = float(np.linalg.norm(axis)) or 1e-6
    axis = axis / length
    side = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    if rounded:
        dome = ((1.0, 0.02), (0.7, 0.7), (0.0, 1.0))
        rings = [(-z * radii[0], r * radii[0]) for z, r in dome]
        rings += [(length + z * radii[1], r * radii[1]) for z, r in reversed(dome)]
    else:
        rings = [(0.0, 1e-3), (0.0, radii[0]), (length, radii[1]), (length, 1e-3)]
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
    lattice = np.stack([a + axis * z + around * r for z, r in rings])
    if not rounded:
        normals = _grid_corners(np.stack([around, around]))
        body = triangles(_grid_corners(lattice[1:3]), look, normals=normals)
        return join(grid(lattice[:2], look), grid(lattice[2:], look), body)
    outward = np.broadcast_to(around, lattice.shape)
    bulge = np.array([-1.0, -0.7, 0.0, 0.0, 0.7, 1.0])[:, None, None] * axis
    n = outward * (1.0 - np.abs(bulge).sum(2, keepdims=True) * 0.9) + bulge
    n = n / np.linalg.norm(n, axis=2, keepdims=True)
    return triangles(_grid_corners(lattice), look, normals=_grid_corners(n))


def ellipsoid(centre: ArrayLike, radii: ArrayLike, look: Look, *, detail: int = 1) -> Mesh:
    """Ellipsoid with smooth normals; detail is the number of icosphere subdivisions."""
    vertices, faces = _solid(detail)
    r = np.asarray(radii, dtype=np.float64)
    normals = vertices / r
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return triangles((vertices * r + np.asarray(centre))[faces], look, normals=normals[faces])


@lru_cache(maxsize=4)
def _solid(detail: int | None = None) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices and faces of a unit cube, or of a unit sphere with `detail` subdivisions."""
    make = trimesh.creation
    solid = make.box((1.0, 1.0, 1.0)) if detail is None else make.icosphere(detail)
    return np.asarray(solid.vertices), np.asarray(solid.faces)
