"""Street furniture: lamps, signs, lights, fences, bollards, bins, shelters."""

from itertools import pairwise

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.names import SceneClass
from training.scenes.textures.surface_kinds import SurfaceKind
from training.scenes.things.mesh import Look, Mesh, box, ellipsoid, join, polygon, tube

_STEEL = (0.25, 0.26, 0.26)
_DARK_STEEL = (0.04, 0.045, 0.045)
_SIGN_KINDS = 8


def _pole(color: tuple[float, ...] = _STEEL) -> Look:
    return Look(SurfaceKind.METAL, color, SceneClass.POLE)


def make_lamp(rng: Generator, height: float) -> Mesh:
    """A street lamp whose arm reaches along +y (over the road)."""
    look = _pole(_STEEL if rng.random() < 0.6 else _DARK_STEEL)
    arm = float(rng.uniform(0.8, 2.2))
    head = Look(SurfaceKind.PLAIN, (0.35, 0.35, 0.33), SceneClass.POLE)
    return join(
        [
            tube((0, 0, 0), (0, 0, 1.2), (0.11, 0.1), look, sides=9),
            tube((0, 0, 1.2), (0, 0, height - 0.4), (0.075, 0.05), look, sides=9),
            tube((0, 0, height - 0.45), (0, arm, height), (0.045, 0.035), look),
            box((0.28, 0.75, 0.13), (0, arm + 0.3, height), head),
        ]
    )


def make_utility_pole(rng: Generator) -> Mesh:
    """A wooden pole with a cross-arm."""
    height = float(rng.uniform(7, 9))
    wood = Look(SurfaceKind.BARK, (0.14, 0.1, 0.07), SceneClass.POLE)
    return join(
        [
            tube((0, 0, 0), (0, 0, height), (0.15, 0.1), wood, sides=9),
            box((0.1, 1.8, 0.12), (0, 0, height - 0.5), wood),
        ]
    )


def make_bollard(rng: Generator) -> Mesh:
    """A bollard about 0.9 m high."""
    tall = float(rng.uniform(0.75, 1.0))
    color = ((0.03, 0.03, 0.03), (0.4, 0.4, 0.4), (0.5, 0.5, 0.48))[rng.integers(3)]
    return tube((0, 0, 0), (0, 0, tall), (0.075, 0.07), _pole(color), sides=9, rounded=True)


def make_sign(rng: Generator, kind: int | None = None) -> Mesh:
    """A traffic sign facing -x, on its pole at the origin.

    Kinds: 0 limit, 1 warning triangle, 2 blue disc, 3 no entry, 4 priority, 5 direction board,
    6 blue square, 7 give way.
    """
    kind = int(rng.integers(_SIGN_KINDS)) if kind is None else kind
    size = float(rng.uniform(0.32, 0.45))
    height = float(rng.uniform(2.2, 3.0))
    wide = 1.0
    if kind == 5:
        size, wide, height = 0.5, float(rng.uniform(1.4, 2.6)), 2.6
    posts = (0.0, 0.7) if kind == 5 else (0.0,)
    parts = [tube((0.05, y, 0), (0.05, y, height + size), (0.04, 0.04), _pole()) for y in posts]
    seed = float(rng.random())
    look = Look(SurfaceKind.SIGN, (0.7, 0.7, 0.7), SceneClass.TRAFFIC_SIGN, (float(kind), seed))
    back = Look(SurfaceKind.METAL, (0.3, 0.3, 0.3), SceneClass.TRAFFIC_SIGN)
    outline = _outline(kind) * (wide, 1.0)
    face = np.stack(
        [np.zeros(len(outline)), -outline[:, 0] * size, outline[:, 1] * size + height], axis=1
    )
    flat = np.stack([outline[:, 0] / wide, outline[:, 1], np.zeros(len(outline))], axis=1)
    parts.append(polygon(face, look, texture=flat))
    parts.append(polygon((face + np.array([0.02, 0, 0]))[::-1], back))
    if rng.random() < 0.2 and kind != 5:
        extra = Look(SurfaceKind.SIGN, (0.7, 0.7, 0.7), SceneClass.TRAFFIC_SIGN, (9.0, seed))
        low = height - size * 1.75
        square = _outline(6)
        corners = np.stack([np.zeros(4), -square[:, 0] * 0.33, square[:, 1] * 0.16 + low], axis=1)
        parts.append(polygon(corners, extra, texture=np.pad(square, ((0, 0), (0, 1)))))
    return join(parts)


def _outline(kind: int) -> Floats:
    if kind in (1, 7):
        points = np.array([[-1, -0.8], [1, -0.8], [0, 0.95]])
        return points if kind == 1 else points[::-1] * (1, -1)
    if kind in (5, 6):
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    if kind == 4:
        return np.array([[0, -1], [1, 0], [0, 1], [-1, 0]], dtype=float)
    t = np.linspace(0, 2 * np.pi, 21)[:-1]
    return np.stack([np.cos(t), np.sin(t)], axis=1)


def make_traffic_light(rng: Generator, phase: int) -> Mesh:
    """A signal facing -x; phase 0 red, 1 amber, 2 green."""
    housing = Look(SurfaceKind.PLAIN, (0.02, 0.022, 0.022), SceneClass.TRAFFIC_LIGHT)
    height = float(rng.uniform(2.4, 3.0))
    pole = _pole(_STEEL if rng.random() < 0.4 else _DARK_STEEL)
    parts = [tube((0.1, 0, 0), (0.1, 0, height + 1.0), (0.06, 0.06), pole)]
    heads = [(0.0, height)]
    if rng.random() < 0.4:
        reach = float(rng.uniform(2.5, 4.0))
        parts.append(tube((0.1, 0, 5.3), (0.1, reach, 5.5), (0.05, 0.05), pole))
        parts.append(tube((0.1, 0, height), (0.1, 0, 5.4), (0.06, 0.06), pole))
        heads.append((reach, 4.9))
    for y, z in heads:
        parts.append(box((0.2, 0.32, 0.95), (0, y, z + 0.45), housing))
        parts.append(box((0.02, 0.5, 1.12), (0.08, y, z + 0.45), housing))
        for k, color in enumerate(((0.9, 0.03, 0.02), (0.9, 0.4, 0.02), (0.03, 0.8, 0.35))):
            lit = 6.0 if k == phase else 0.0
            dim = color if k == phase else tuple(0.06 * c + 0.01 for c in color)
            lens = Look(SurfaceKind.GLOW, dim, SceneClass.TRAFFIC_LIGHT, (lit,))
            lamp = (-0.1, y, z + 0.75 - 0.3 * k)
            parts.append(ellipsoid(lamp, (0.03, 0.1, 0.1), lens))
            parts.append(box((0.14, 0.22, 0.015), (-0.15, y, z + 0.86 - 0.3 * k), housing))
    return join(parts)


def make_railing(length: float, rng: Generator) -> Mesh:
    """A railing of thin bars along x, starting at the origin."""
    color = ((0.03, 0.04, 0.04), (0.3, 0.31, 0.31), (0.03, 0.1, 0.06))[rng.integers(3)]
    look = Look(SurfaceKind.METAL, color, SceneClass.FENCE)
    parts = [box((length, 0.05, 0.05), (length / 2, 0, z), look) for z in (0.12, 1.05)]
    for x in np.arange(0.0, length + 0.01, 0.14):
        thick = 0.06 if round(x / 0.14) % 14 == 0 else 0.025
        parts.append(box((thick, thick, 1.05), (x, 0, 0.55), look))
    return join(parts)


def make_board_fence(length: float, height: float, rng: Generator) -> Mesh:
    """A closed wooden fence along x, starting at the origin."""
    tone = rng.uniform(0.5, 1.3)
    color, boards = (0.2 * tone, 0.13 * tone, 0.08 * tone), (0.14, 0.6, float(rng.random()))
    look = Look(SurfaceKind.PLANKS, color, SceneClass.FENCE, boards)
    return box((length, 0.06, height), (length / 2, 0, height / 2), look)


def make_wall(length: float, height: float, rng: Generator) -> Mesh:
    """A low brick wall along x, starting at the origin; Fence, as CamVid labels garden walls."""
    tone = rng.uniform(0.7, 1.3)
    look = Look(SurfaceKind.BRICKWORK, (0.28 * tone, 0.15 * tone, 0.1 * tone), SceneClass.FENCE)
    cap = Look(SurfaceKind.STONE, (0.4, 0.39, 0.36), SceneClass.FENCE)
    return join(
        [
            box((length, 0.24, height), (length / 2, 0, height / 2), look),
            box((length, 0.3, 0.07), (length / 2, 0, height + 0.03), cap),
        ]
    )


def make_guard_rail(length: float) -> Mesh:
    """A steel guard rail along x, starting at the origin, its beam towards -y."""
    look = Look(SurfaceKind.METAL, (0.42, 0.43, 0.44), SceneClass.GUARD_RAIL)
    profile = [(-0.05, 0.45), (-0.13, 0.52), (-0.06, 0.6), (-0.13, 0.68), (-0.05, 0.75)]
    parts = [
        polygon([(0, a, za), (length, a, za), (length, b, zb), (0, b, zb)], look)
        for (a, za), (b, zb) in pairwise(profile)
    ]
    parts += [box((0.1, 0.08, 0.75), (x, 0, 0.37), look) for x in np.arange(0.5, length, 2.0)]
    return join(parts)


def make_bin(rng: Generator) -> Mesh:
    """A wheelie bin or litter bin."""
    color = ((0.03, 0.08, 0.04), (0.03, 0.03, 0.03), (0.08, 0.09, 0.1), (0.05, 0.08, 0.2))
    look = Look(SurfaceKind.PLAIN, color[rng.integers(4)], SceneClass.MISC, (0.25,))
    return join(
        [box((0.55, 0.55, 0.95), (0, 0, 0.5), look), box((0.62, 0.6, 0.08), (0, 0, 1.0), look)]
    )


def make_bench() -> Mesh:
    """A bench facing +y."""
    wood = Look(SurfaceKind.PLANKS, (0.2, 0.12, 0.07), SceneClass.MISC, (0.12, 0.5, 0.3))
    iron = Look(SurfaceKind.METAL, _DARK_STEEL, SceneClass.MISC)
    return join(
        [
            box((1.7, 0.45, 0.06), (0, 0, 0.45), wood),
            box((1.7, 0.06, 0.4), (0, -0.25, 0.75), wood),
            *(box((0.06, 0.45, 0.45), (x, 0, 0.22), iron) for x in (-0.7, 0.7)),
        ]
    )


def make_shelter(rng: Generator) -> Mesh:
    """A bus shelter opening towards +y."""
    steel = Look(SurfaceKind.METAL, (0.12, 0.13, 0.14), SceneClass.MISC)
    color, print_ = tuple(rng.uniform(0.1, 0.6, 3)), (0.6, 0.5, float(rng.random()))
    poster = Look(SurfaceKind.PLANKS, color, SceneClass.MISC, print_)
    glass = Look(SurfaceKind.CAR_GLASS, (0.05, 0.06, 0.06), SceneClass.MISC, (0.5,))
    return join(
        [
            box((3.8, 1.5, 0.12), (0, 0.1, 2.5), steel),
            box((3.6, 0.04, 1.9), (0, -0.5, 1.3), glass),
            box((0.12, 1.2, 2.0), (-1.8, 0.1, 1.2), poster),
            *(box((0.08, 0.08, 2.5), (x, -0.5, 1.25), steel) for x in (-1.8, 0.0, 1.8)),
        ]
    )
