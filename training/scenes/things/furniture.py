"""Street furniture: lamps, signs, lights, fences, bollards, bins, shelters."""

from itertools import pairwise

import numpy as np
from numpy.random import Generator

from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, Mesh, box, ellipsoid, join, pick, polygon, rows, tube

_STEEL, _DARK_STEEL = (0.25, 0.26, 0.26), (0.04, 0.045, 0.045)
_BOLLARDS = rows("0.03 0.03 0.03, 0.4 0.4 0.4, 0.5 0.5 0.48")
_RAILINGS = rows("0.03 0.04 0.04, 0.3 0.31 0.31, 0.03 0.1 0.06")
_BINS = rows("0.03 0.08 0.04, 0.03 0.03 0.03, 0.08 0.09 0.1, 0.05 0.08 0.2")
_SIGNALS = rows("0.9 0.03 0.02, 0.9 0.4 0.02, 0.03 0.8 0.35")
_BOARD, _SQUARE = 5, 6  # kinds of sign
# Outlines of the signs that are not discs, -1..1, by kind.
_TRIANGLE = np.array([[-1, -0.8], [1, -0.8], [0, 0.95]])
_QUAD = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
_OUTLINES = {
    1: _TRIANGLE,
    4: np.array([[0.0, -1], [1, 0], [0, 1], [-1, 0]]),
    _BOARD: _QUAD,
    _SQUARE: _QUAD,
    7: _TRIANGLE[::-1] * (1, -1),
}


def _pole(color: tuple[float, ...] = _STEEL) -> Look:
    return Look(SurfaceKind.METAL, color, SceneClass.POLE)


def make_lamp(rng: Generator, height: float) -> Mesh:
    """A street lamp whose arm reaches along +y (over the road)."""
    look = _pole(_STEEL if rng.random() < 0.6 else _DARK_STEEL)
    arm = rng.uniform(0.8, 2.2)
    head = Look(SurfaceKind.PLAIN, (0.35, 0.35, 0.33), SceneClass.POLE)
    return join(
        tube((0, 0, 0), (0, 0, 1.2), (0.11, 0.1), look, sides=9),
        tube((0, 0, 1.2), (0, 0, height - 0.4), (0.075, 0.05), look, sides=9),
        tube((0, 0, height - 0.45), (0, arm, height), (0.045, 0.035), look),
        box((0.28, 0.75, 0.13), (0, arm + 0.3, height), head),
    )


def make_utility_pole(rng: Generator) -> Mesh:
    """A wooden pole with a cross-arm."""
    height = rng.uniform(7, 9)
    wood = Look(SurfaceKind.BARK, (0.14, 0.1, 0.07), SceneClass.POLE)
    pole = tube((0, 0, 0), (0, 0, height), (0.15, 0.1), wood, sides=9)
    return join(pole, box((0.1, 1.8, 0.12), (0, 0, height - 0.5), wood))


def make_bollard(rng: Generator) -> Mesh:
    """A bollard about 0.9 m high."""
    top = (0, 0, rng.uniform(0.75, 1.0))
    return tube((0, 0, 0), top, (0.075, 0.07), _pole(pick(_BOLLARDS, rng)), sides=9, rounded=True)


def make_sign(rng: Generator, kind: int | None = None) -> Mesh:
    """Make a traffic sign that faces -x, on its pole at the origin.

    The kinds are 0 limit, 1 warning triangle, 2 blue disc, 3 no entry, 4 priority, 5 direction
    board, 6 blue square and 7 give way.
    """
    kind = int(rng.integers(8)) if kind is None else kind
    size, height, wide = rng.uniform(0.32, 0.45), rng.uniform(2.2, 3.0), 1.0
    if kind == _BOARD:
        size, wide, height = 0.5, rng.uniform(1.4, 2.6), 2.6
    posts = (0.0, 0.7) if kind == _BOARD else (0.0,)
    parts = [tube((0.05, y, 0), (0.05, y, height + size), (0.04, 0.04), _pole()) for y in posts]
    seed = rng.random()
    parts += _plate(kind, float(kind), seed, (size * wide, size), height, back=True)
    if rng.random() < 0.2 and kind != _BOARD:
        parts += _plate(_SQUARE, 9.0, seed, (0.33, 0.16), height - size * 1.75, back=False)
    return join(*parts)


def _plate(
    outline: int, text: float, seed: float, half: tuple[float, float], up: float, *, back: bool
) -> list[Mesh]:
    """The face of a sign of half this width and height, and its back."""
    turns = np.linspace(0, 2 * np.pi, 21)[:-1]
    flat = _OUTLINES.get(outline, np.stack([np.cos(turns), np.sin(turns)], axis=1))
    y, z = -flat[:, 0] * half[0], flat[:, 1] * half[1] + up
    face = np.stack([np.zeros(len(flat)), y, z], axis=1)
    look = Look(SurfaceKind.SIGN, (0.7, 0.7, 0.7), SceneClass.TRAFFIC_SIGN, (text, seed))
    steel = Look(SurfaceKind.METAL, (0.3, 0.3, 0.3), SceneClass.TRAFFIC_SIGN)
    front = polygon(face, look, texture=np.pad(flat, ((0, 0), (0, 1))))
    return [front, polygon(np.add(face, (0.02, 0, 0))[::-1], steel)] if back else [front]


def make_traffic_light(rng: Generator, phase: int) -> Mesh:
    """A signal facing -x; phase 0 red, 1 amber, 2 green."""
    housing = Look(SurfaceKind.PLAIN, (0.02, 0.022, 0.022), SceneClass.TRAFFIC_LIGHT)
    height = rng.uniform(2.4, 3.0)
    pole = _pole(_STEEL if rng.random() < 0.4 else _DARK_STEEL)
    parts = [tube((0.1, 0, 0), (0.1, 0, height + 1.0), (0.06, 0.06), pole)]
    heads = [(0.0, height)]
    if rng.random() < 0.4:
        reach = rng.uniform(2.5, 4.0)
        parts.append(tube((0.1, 0, 5.3), (0.1, reach, 5.5), (0.05, 0.05), pole))
        parts.append(tube((0.1, 0, height), (0.1, 0, 5.4), (0.06, 0.06), pole))
        heads.append((reach, 4.9))
    for y, z in heads:
        parts.append(box((0.2, 0.32, 0.95), (0, y, z + 0.45), housing))
        parts.append(box((0.02, 0.5, 1.12), (0.08, y, z + 0.45), housing))
        for k, color in enumerate(_SIGNALS):
            shade, glow = (color, 6.0) if k == phase else ([0.06 * c + 0.01 for c in color], 0.0)
            lens = Look(SurfaceKind.GLOW, tuple(shade), SceneClass.TRAFFIC_LIGHT, (glow,))
            parts.append(ellipsoid((-0.1, y, z + 0.75 - 0.3 * k), (0.03, 0.1, 0.1), lens))
            parts.append(box((0.14, 0.22, 0.015), (-0.15, y, z + 0.86 - 0.3 * k), housing))
    return join(*parts)


def make_railing(length: float, rng: Generator) -> Mesh:
    """A railing of thin bars along x, starting at the origin."""
    look = Look(SurfaceKind.METAL, pick(_RAILINGS, rng), SceneClass.FENCE)
    parts = [box((length, 0.05, 0.05), (length / 2, 0, z), look) for z in (0.12, 1.05)]
    for x in np.arange(0.0, length + 0.01, 0.14):
        thick = 0.06 if round(x / 0.14) % 14 == 0 else 0.025
        parts.append(box((thick, thick, 1.05), (x, 0, 0.55), look))
    return join(*parts)


def make_board_fence(length: float, rng: Generator) -> Mesh:
    """A closed wooden fence along x, starting at the origin."""
    height, tone = rng.uniform(0.9, 1.9), rng.uniform(0.5, 1.3)
    color, boards = (0.2 * tone, 0.13 * tone, 0.08 * tone), (0.14, 0.6, rng.random())
    look = Look(SurfaceKind.PLANKS, color, SceneClass.FENCE, boards)
    return box((length, 0.06, height), (length / 2, 0, height / 2), look)


def make_wall(length: float, rng: Generator) -> Mesh:
    """Make a low brick wall along x from the origin; a Fence, as CamVid labels garden walls."""
    height, tone = rng.uniform(0.5, 1.6), rng.uniform(0.7, 1.3)
    look = Look(SurfaceKind.BRICKWORK, (0.28 * tone, 0.15 * tone, 0.1 * tone), SceneClass.FENCE)
    cap = Look(SurfaceKind.STONE, (0.4, 0.39, 0.36), SceneClass.FENCE)
    wall = box((length, 0.24, height), (length / 2, 0, height / 2), look)
    return join(wall, box((length, 0.3, 0.07), (length / 2, 0, height + 0.03), cap))


def make_guard_rail(length: float) -> Mesh:
    """A steel guard rail along x, starting at the origin, its beam towards -y."""
    look = Look(SurfaceKind.METAL, (0.42, 0.43, 0.44), SceneClass.GUARD_RAIL)
    profile = rows("-0.05 0.45, -0.13 0.52, -0.06 0.6, -0.13 0.68, -0.05 0.75")
    beam = (
        polygon([(0, a, za), (length, a, za), (length, b, zb), (0, b, zb)], look)
        for (a, za), (b, zb) in pairwise(profile)
    )
    posts = (box((0.1, 0.08, 0.75), (x, 0, 0.37), look) for x in np.arange(0.5, length, 2.0))
    return join(*beam, *posts)


def make_bin(rng: Generator) -> Mesh:
    """A wheelie bin or litter bin."""
    look = Look(SurfaceKind.PLAIN, pick(_BINS, rng), SceneClass.MISC, (0.25,))
    lid = box((0.62, 0.6, 0.08), (0, 0, 1.0), look)
    return join(box((0.55, 0.55, 0.95), (0, 0, 0.5), look), lid)


def make_bench() -> Mesh:
    """A bench facing +y."""
    wood = Look(SurfaceKind.PLANKS, (0.2, 0.12, 0.07), SceneClass.MISC, (0.12, 0.5, 0.3))
    iron = Look(SurfaceKind.METAL, _DARK_STEEL, SceneClass.MISC)
    return join(
        box((1.7, 0.45, 0.06), (0, 0, 0.45), wood),
        box((1.7, 0.06, 0.4), (0, -0.25, 0.75), wood),
        *(box((0.06, 0.45, 0.45), (x, 0, 0.22), iron) for x in (-0.7, 0.7)),
    )


def make_shelter(rng: Generator) -> Mesh:
    """A bus shelter opening towards +y."""
    steel = Look(SurfaceKind.METAL, (0.12, 0.13, 0.14), SceneClass.MISC)
    color, print_ = tuple(rng.uniform(0.1, 0.6, 3)), (0.6, 0.5, rng.random())
    poster = Look(SurfaceKind.PLANKS, color, SceneClass.MISC, print_)
    glass = Look(SurfaceKind.CAR_GLASS, (0.05, 0.06, 0.06), SceneClass.MISC, (0.5,))
    return join(
        box((3.8, 1.5, 0.12), (0, 0.1, 2.5), steel),
        box((3.6, 0.04, 1.9), (0, -0.5, 1.3), glass),
        box((0.12, 1.2, 2.0), (-1.8, 0.1, 1.2), poster),
        *(box((0.08, 0.08, 2.5), (x, -0.5, 1.25), steel) for x in (-1.8, 0.0, 1.8)),
    )
