"""Town houses, detached houses, office blocks and sheds with façades, roofs and shop fronts."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from training.scenes.names import SceneClass
from training.scenes.textures.surface_kinds import SurfaceKind
from training.scenes.things.mesh import Color, Look, Mesh, box, join, polygon, rows, vary

_PLASTER = rows(
    "0.62 0.58 0.5, 0.7 0.69 0.66, 0.6 0.5 0.32, 0.55 0.42 0.33, 0.5 0.52 0.5, "
    "0.68 0.6 0.44, 0.45 0.42 0.4, 0.58 0.36 0.28"
)
_BRICK = rows("0.32 0.16 0.1, 0.38 0.27 0.17, 0.26 0.13 0.09, 0.45 0.36 0.24, 0.22 0.17 0.14")
_ROOF = rows("0.24 0.09 0.05, 0.1 0.1 0.11, 0.16 0.1 0.07, 0.3 0.13 0.07")

_OFFICE = rows("0.5 0.49 0.46, 0.33 0.34 0.35, 0.6 0.58 0.52, 0.36 0.22 0.16")

#: Façade styles the shader knows.
PLASTER, BRICK, OFFICE, SHED = 0.0, 1.0, 2.0, 3.0


def _walls(length: float, depth: float, height: float, look: Look) -> list[Mesh]:
    """Four walls around (0..length, 0..-depth), texture x along the wall, z up."""
    x0, x1, y0, y1 = 0.0, length, 0.0, -depth
    runs = [((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)), ((x0, y1), (x0, y0))]
    walls = []
    for k, ((ax, ay), (bx, by)) in enumerate(runs):
        run = float(np.hypot(bx - ax, by - ay))
        corners = [(bx, by, -3), (ax, ay, -3), (ax, ay, height), (bx, by, height)]
        texture = np.array([(run, k, -3), (0, k, -3), (0, k, height), (run, k, height)])
        bay = run / max(1, round(run / look.params[0]))
        wall = replace(look, params=(bay, *look.params[1:]))
        walls.append(polygon(corners, wall, texture=texture))
    return walls


def _flat_roof(length: float, depth: float, height: float, look: Look) -> Mesh:
    corners = [(0, 0, height), (length, 0, height), (length, -depth, height), (0, -depth, height)]
    return polygon(corners, look)


def _gable_roof(
    length: float,
    depth: float,
    height: float,
    rise: float,
    roof: Look,
    wall: Look,
    *,
    across: bool,
    eaves: float = 0.4,
) -> list[Mesh]:
    """A pitched roof; `across` turns the gable to the street."""
    # Ends of the ridge and of the walls along it; then positions across it.
    if across:
        ridge_ends, wall_ends = (eaves, -depth - eaves), (0.0, -depth)
        eaves_at, walls_at, middle = (-eaves, length + eaves), (0.0, length), length / 2
    else:
        ridge_ends, wall_ends = (-0.1, length + 0.1), (0.0, length)
        eaves_at, walls_at, middle = (eaves, -depth - eaves), (0.0, -depth), -depth / 2

    def at(along: float, beside: float, z: float) -> tuple[float, float, float]:
        return (beside, along, z) if across else (along, beside, z)

    top, low = height + rise, height - rise * eaves / abs(middle)
    first, last = (at(end, middle, top) for end in ridge_ends)
    front = [*(at(end, eaves_at[0], low) for end in ridge_ends), last, first]
    back = [*(at(end, eaves_at[1], low) for end in ridge_ends[::-1]), first, last]
    if across:  # the swap of x and y mirrors the polygons, so their corners are reversed
        front, back = ([side[0], *side[:0:-1]] for side in (front, back))
    gables = [
        [at(end, walls_at[0], height), at(end, walls_at[1], height), at(end, middle, top)]
        for end in wall_ends
    ]
    plain = replace(wall, params=(100.0, *wall.params[1:]))
    parts = []
    for side in (front, back):
        points = np.asarray(side)
        # u along the ridge, v down the slope: rows of tiles follow the eaves.
        along = points[1] - points[0] if not across else points[3] - points[0]
        along = along / np.linalg.norm(along)
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        down = np.cross(normal / np.linalg.norm(normal), along)
        texture = np.stack([points @ along, points @ down, np.zeros(4)], axis=1)
        parts.append(polygon(points, roof, texture=texture))
    for gable in gables:
        points = np.asarray([*gable, gable[-1]])
        run = points[:, 1] if not across else points[:, 0]
        texture = np.stack([run, np.full(4, 1.0), points[:, 2] + 100.0], axis=1)
        parts.append(polygon(points, plain, texture=texture))
    return parts


def make_town_house(rng: Generator, length: float, *, shop: bool) -> Mesh:
    """A house of a closed row: front wall on y = 0 facing +y, from x = 0 to length."""
    brick = rng.random() < 0.45
    color = _draw_tone(_BRICK if brick else _PLASTER, rng)
    floors = int(rng.integers(2, 6))
    floor = float(rng.uniform(2.8, 3.4))
    ground = float(rng.uniform(3.4, 4.2)) if shop else floor
    height = ground + (floors - 1) * floor + 0.4
    depth = float(rng.uniform(8, 14))
    look = _facade(
        color,
        rng.uniform((1.9, 0.36, 0.48), (3.2, 0.55, 0.62)),
        floor,
        (BRICK if brick else PLASTER, 1.0 if shop else 2.0, ground),
        rng,
    )
    parts = _walls(length, depth, height, look)
    trim = _look(SurfaceKind.STONE, _tone((0.55, 0.53, 0.48), rng))
    roof = _look(SurfaceKind.ROOF, _draw_tone(_ROOF, rng))
    if rng.random() < 0.6:
        rise = float(rng.uniform(2.0, 4.0))
        across = length < 9 and rng.random() < 0.25
        parts += _gable_roof(length, depth, height, rise, roof, look, across=across)
        if not across:
            stack = _look(SurfaceKind.BRICKWORK, (0.3, 0.15, 0.1))
            at = (length * rng.uniform(0.1, 0.9), -depth / 2 + 0.4, height + rise)
            parts.append(box((0.9, 0.6, 2.0), at, stack))
            if rng.random() < 0.5:
                for x in np.arange(1.8, length - 1.2, 3.2):
                    parts.append(_dormer(x, height, rise, depth, look))
    else:
        parts.append(_flat_roof(length, depth, height, roof))
        parts.append(box((length + 0.1, 0.3, 0.7), (length / 2, -0.1, height + 0.3), trim))
    if rng.random() < 0.7:
        parts.append(box((length, 0.35, 0.22), (length / 2, 0.12, height - 0.1), trim))
    if rng.random() < 0.4:
        parts.append(box((length, 0.14, 0.15), (length / 2, 0.04, ground), trim))
    if shop and rng.random() < 0.4:
        parts.append(_awning(length, rng))
    if not shop and rng.random() < 0.25:
        iron = _look(SurfaceKind.PLAIN, (0.12, 0.12, 0.12))
        for level in range(1, floors):
            z = ground + (level - 1) * floor + 0.15
            parts.append(box((2.2, 1.0, 0.14), (length / 2, 0.5, z), trim))
            parts.append(box((2.2, 0.04, 0.9), (length / 2, 0.98, z + 0.5), iron))
    return join(parts)


def _look(kind: SurfaceKind, color: Color, *params: float) -> Look:
    return Look(kind, color, SceneClass.BUILDING, params)


def _facade(
    color: Color,
    windows: Iterable[float],
    floor: float,
    ground_floor: tuple[float, float, float],
    rng: Generator,
) -> Look:
    """The wall of a house.

    windows: width of a bay [m], width and height of its window as shares of bay and floor. floor:
    its height [m]. ground_floor: façade style, 0 no openings, 1 shops or 2 doors, height [m].
    """
    bay, wide, tall = windows
    params = (bay, floor, wide, tall, *ground_floor, float(rng.random()))
    return _look(SurfaceKind.FACADE, color, *params)


def _draw_tone(palette: tuple[Color, ...], rng: Generator) -> Color:
    return _tone(palette[rng.integers(len(palette))], rng)


def _tone(color: Color, rng: Generator) -> Color:
    return vary(color, rng, most=1.15, tint=0.06, limits=(0.02, 0.85))


def _dormer(x: float, height: float, rise: float, depth: float, wall: Look) -> Mesh:
    setback = depth * 0.12
    z = height + rise * setback / (depth / 2)
    window = (1.3, 1.4, 0.6, 0.65, PLASTER, 0.0, 0.0, wall.params[7])
    look = _look(SurfaceKind.FACADE, (0.5, 0.49, 0.46), *window)
    walls = join(_walls(1.3, 1.6, 1.3, look)).moved(offset=(x - 0.65, -setback, z))
    lid = _look(SurfaceKind.PLAIN, (0.1, 0.1, 0.11))
    return join([walls, box((1.6, 1.9, 0.12), (x, -setback - 0.7, z + 1.36), lid)])


def _awning(length: float, rng: Generator) -> Mesh:
    color = ((0.4, 0.05, 0.04), (0.05, 0.2, 0.1), (0.08, 0.12, 0.3), (0.55, 0.5, 0.4))
    look = _look(SurfaceKind.PLANKS, color[rng.integers(4)], 0.5, 0.9, float(rng.random()))
    a, b = 0.6, length - 0.6
    top, low = 3.0, 2.5
    return polygon([(a, 0.02, top), (a, 1.3, low), (b, 1.3, low), (b, 0.02, top)], look)


def make_office(rng: Generator, length: float) -> Mesh:
    """A modern block with bands of windows and a flat roof."""
    floors = int(rng.integers(3, 9))
    floor = float(rng.uniform(3.1, 3.6))
    height = floors * floor + 0.8
    depth = float(rng.uniform(12, 18))
    color = _draw_tone(_OFFICE, rng)
    windows = rng.uniform((1.2, 0.7, 0.45), (2.6, 0.94, 0.75))
    front = 1.0 if rng.random() < 0.5 else 0.0
    look = _facade(color, windows, floor, (OFFICE, front, 3.8), rng)
    roof = _look(SurfaceKind.PLAIN, (0.25, 0.25, 0.25))
    parts = _walls(length, depth, height, look)
    parts.append(_flat_roof(length, depth, height, roof))
    size = (length * 0.3, depth * 0.4, 2.2)
    parts.append(box(size, (length / 2, -depth / 2, height + 1.1), roof))
    return join(parts)


def make_house(rng: Generator, length: float) -> Mesh:
    """A detached house with a pitched roof."""
    brick = rng.random() < 0.5
    color = _draw_tone(_BRICK if brick else _PLASTER, rng)
    floors = int(rng.integers(1, 3))
    height = 2.7 * floors + 0.4
    depth = float(rng.uniform(7, 10))
    windows = (*rng.uniform((2.2, 0.38), (3.4, 0.55)), 0.5)
    look = _facade(color, windows, 2.7, (BRICK if brick else PLASTER, 2.0, 2.7), rng)
    roof = _look(SurfaceKind.ROOF, _draw_tone(_ROOF, rng))
    parts = _walls(length, depth, height, look)
    rise, across = float(rng.uniform(2.2, 3.6)), bool(rng.random() < 0.35)
    parts += _gable_roof(length, depth, height, rise, roof, look, across=across, eaves=0.5)
    stack = _look(SurfaceKind.BRICKWORK, (0.3, 0.15, 0.1))
    parts.append(box((0.7, 0.5, 2.4), (length * 0.8, -depth / 2 - 0.6, height + 2.6), stack))
    return join(parts)


def make_shed(rng: Generator, length: float) -> Mesh:
    """A warehouse or supermarket of ribbed sheet."""
    height, depth = float(rng.uniform(5, 9)), float(rng.uniform(15, 25))
    color = _tone((0.5, 0.52, 0.54), rng)
    front = 1.0 if rng.random() < 0.5 else 0.0
    look = _facade(color, (6.0, 0.8, 0.12), height * 0.8, (SHED, front, 3.6), rng)
    roof = _look(SurfaceKind.PLAIN, (0.3, 0.3, 0.3))
    return join([*_walls(length, depth, height, look), _flat_roof(length, depth, height, roof)])
