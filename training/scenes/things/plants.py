"""Trees, bushes, hedges: dark cores wrapped in clouds of small leaf cards."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, Mesh, ellipsoid, join, rows, triangles, tube, vary

_LEAVES = rows(
    "0.07 0.12 0.025, 0.05 0.1 0.03, 0.1 0.14 0.03, 0.12 0.13 0.03, 0.06 0.085 0.03, "
    "0.16 0.12 0.03, 0.2 0.1 0.03"
)
_NEEDLES = rows("0.035 0.065 0.03")


def _leaf_cloud(blobs: Floats, look: Look, count: int, size: float, rng: Generator) -> Mesh:
    """Leaf cards distributed over blobs given as rows of (x, y, z, rx, ry, rz).

    Normals point away from the blob's centre, which shades a crown as one soft volume; leaves
    low and deep inside are darker.
    """
    weight = blobs[:, 3] * blobs[:, 5]
    which = rng.choice(len(blobs), count, p=weight / weight.sum())
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    depth = 1.12 - 0.36 * rng.random(count) ** 1.5
    centre = blobs[which, :3] + direction * blobs[which, 3:] * depth[:, None]
    corner = rng.standard_normal((count, 3, 3)) * size * rng.uniform(0.6, 1.2, (count, 1, 1))
    middle = blobs[:, :3].mean(axis=0)
    normal = direction + 0.7 * (centre - middle) / (np.abs(blobs[:, 3:]).max() + 1.0)
    normal = normal + 0.35 * rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mesh = triangles(centre[:, None] + corner, look, normals=np.repeat(normal[:, None], 3, axis=1))
    low, high = centre[:, 2].min(), centre[:, 2].max()
    shade = 0.45 + 0.55 * (centre[:, 2] - low) / max(high - low, 0.1)
    shade = shade * rng.uniform(0.7, 1.3, count) * np.clip(2.4 * depth - 1.4, 0.4, 1.1)
    mesh.color[:] = mesh.color * shade[:, None].astype(np.float32)
    return mesh


def _blobs(*columns: float | Floats) -> Floats:
    """Rows of (x, y, z, rx, ry, rz)."""
    return np.stack(np.broadcast_arrays(*columns), axis=1)


def _foliage(colors: Sequence[tuple[float, ...]], label: SceneClass, rng: Generator) -> Look:
    return Look(SurfaceKind.FOLIAGE, vary(colors, rng, most=1.25, tint=0.1, limits=(0, 1)), label)


def _crown(
    blobs: Floats, look: Look, count: int, size: float, rng: Generator, *, core: float, dark: float
) -> list[Mesh]:
    """Make a cloud of leaves around cores with a share of the blobs' size and brightness."""
    leaves = _leaf_cloud(blobs, look, count, size, rng)
    inner = replace(look, color=tuple(dark * c for c in look.color))
    return [leaves, *(ellipsoid(b[:3], b[3:] * core, inner) for b in blobs)]


def make_tree(rng: Generator, *, leaf_count: int = 3600) -> Mesh:
    """Make a broad-leaved tree, 5 to 13 m high; far trees need few, large leaves."""
    look = _foliage(_LEAVES, SceneClass.TREE, rng)
    height = rng.uniform(5, 13)
    trunk_top, spread = height * rng.uniform(0.25, 0.4), height * rng.uniform(0.2, 0.34)
    count = int(rng.integers(6, 11))
    level = rng.uniform(0, 1, count)
    radius = spread * np.sqrt(np.clip(1 - (2 * level - 0.8) ** 2 * 0.7, 0.1, 1)) * 0.75
    angle = rng.uniform(0, 2 * np.pi, count)
    size = spread * rng.uniform(0.4, 0.65, count)
    x, y = np.cos(angle) * radius * 0.75, np.sin(angle) * radius * 0.75
    z = trunk_top + 0.25 * spread + level * (height - trunk_top - 0.5 * spread)
    blobs = _blobs(x, y, z, size, size, size * 0.8)
    leaf_size = (0.075 + 0.008 * height) * np.sqrt(3600 / leaf_count)
    crown = _crown(blobs, look, leaf_count, leaf_size, rng, core=0.74, dark=0.4)
    bark = Look(SurfaceKind.BARK, (0.1, 0.075, 0.055), SceneClass.TREE)
    thick = 0.012 * height + 0.06
    fork = np.array([rng.normal(0, 0.1), rng.normal(0, 0.1), trunk_top])
    trunk = tube((0, 0, -0.3), fork, (thick * 1.25, thick * 0.8), bark, sides=9)
    low, radii = fork - (0, 0, 0.2), (thick * 0.5, thick * 0.2)
    return join(*crown, trunk, *(tube(low, at, radii, bark, sides=5) for at in blobs[:, :3]))


def make_conifer(rng: Generator, *, leaf_count: int = 1800) -> Mesh:
    """A conifer or poplar: a narrow column of foliage."""
    look = _foliage(_NEEDLES, SceneClass.TREE, rng)
    height = float(rng.uniform(5, 14))
    level = np.linspace(0.1, 0.95, 8)
    size = height * float(rng.uniform(0.1, 0.2)) * (1.05 - level)
    x, y = rng.normal(0, 0.1, (2, 8))
    blobs = _blobs(x, y, level * height, size, size, height * 0.09)
    leaf_size = 0.17 * np.sqrt(1800 / leaf_count)
    crown = _crown(blobs, look, leaf_count, leaf_size, rng, core=0.85, dark=0.4)
    bark = Look(SurfaceKind.BARK, (0.09, 0.065, 0.045), SceneClass.TREE)
    return join(*crown, tube((0, 0, -0.3), (0, 0, height * 0.8), (0.18, 0.05), bark))


def make_bare_tree(rng: Generator) -> Mesh:
    """A leafless tree of branching tubes."""
    bark = Look(SurfaceKind.BARK, (0.07, 0.055, 0.045), SceneClass.TREE)
    parts: list[Mesh] = []

    def grow(base: Floats, heading: Floats, length: float, radius: float, level: int) -> None:
        tip = base + heading * length
        parts.append(tube(base, tip, (radius, radius * 0.65), bark, sides=6 if level < 2 else 3))
        if level == 5:
            return
        for _ in range(3 if level < 4 else 4):
            turn = heading + rng.standard_normal(3) * 0.5 + (0, 0, 0.12)
            turn /= np.linalg.norm(turn)
            fork = tip - heading * length * rng.uniform(0, 0.35)
            grow(fork, turn, length * rng.uniform(0.6, 0.82), radius * 0.56, level + 1)

    height = float(rng.uniform(7, 12))
    grow(np.array([0, 0, -0.3]), np.array([0, 0, 1.0]), height * 0.28, 0.018 * height, 0)
    return join(*parts)


def make_bush(rng: Generator) -> Mesh:
    """A round bush about 1 m high."""
    look = _foliage(_LEAVES[:5], SceneClass.VEGETATION, rng)
    count = int(rng.integers(3, 6))
    size = rng.uniform(0.4, 0.8, count)
    x, y = rng.normal(0, 0.5, count), rng.normal(0, 0.4, count)
    blobs = _blobs(x, y, size * 0.7, size, size, size * 0.85)
    return join(*_crown(blobs, look, 800, 0.085, rng, core=0.8, dark=0.45))


def make_hedge(length: float, rng: Generator) -> Mesh:
    """A clipped hedge along x, centred on the origin."""
    height = rng.uniform(0.9, 1.9)
    look = _foliage(_LEAVES[:3], SceneClass.VEGETATION, rng)
    x = np.linspace(-length / 2, length / 2, max(2, int(length / 0.6)))
    blobs = _blobs(x, 0.0, height * 0.5, 0.5, 0.38, height * 0.5)
    return join(*_crown(blobs, look, int(110 * length), 0.09, rng, core=0.96, dark=0.5))
