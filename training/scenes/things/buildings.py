"""Town houses, detached houses, office blocks and sheds with façades, roofs and shop fronts."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.random import Generator

from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Color, Look, Mesh, box, join, pick, polygon, rows, vary

_PLASTER = rows(
    "0.62 0.58 0.5, 0.7 0.69 0.66, 0.6 0.5 0.32, 0.55 0.42 0.33, 0.5 0.52 0.5, "
    "0.68 0.6 0.44, 0.45 0.42 0.4, 0.58 0.36 0.28"
)
_BRICK = rows("0.32 0.16 0.1, 0.38 0.27 0.17, 0.26 0.13 0.09, 0.45 0.36 0.24, 0.22 0.17 0.14")
_ROOF = rows("0.24 0.09 0.05, 0.1 0.1 0.11, 0.16 0.1 0.07, 0.3 0.13 0.07")
_AWNING = rows("0.4 0.05 0.04, 0.05 0.2 0.1, 0.08 0.12 0.3, 0.55 0.5 0.4")
_TRIM, _SHEET = rows("0.55 0.53 0.48"), rows("0.5 0.52 0.54")
_OFFICE = rows("0.5 0.49 0.46, 0.33 0.34 0.35, 0.6 0.58 0.52, 0.36 0.22 0.16")

# Façade styles the shader knows.
PLASTER, BRICK, OFFICE, SHED = 0.0, 1.0, 2.0, 3.0


def _walls(
    length: float, depth: float, height: float, look: Look, roof: Look | None = None
) -> list[Mesh]:
    """Make four walls around (0..length, 0..-depth), texture x along the wall, and a flat roof."""
    plan = [(0.0, 0.0), (length, 0.0), (length, -depth), (0.0, -depth), (0.0, 0.0)]
    walls = []
    for k, ((ax, ay), (bx, by)) in enumerate(pairwise(plan)):
        run = float(np.hypot(bx - ax, by - ay))
        corners = [(bx, by, -3), (ax, ay, -3), (ax, ay, height), (bx, by, height)]
        texture = np.array([(run, k, -3), (0, k, -3), (0, k, height), (run, k, height)])
        bay = run / max(1, round(run / look.params[0]))
        wall = replace(look, params=(bay, *look.params[1:]))
        walls.append(polygon(corners, wall, texture=texture))
    if roof:
        walls.append(polygon([(x, y, height) for x, y in plan[:4]], roof))
    return walls


def _gable_roof(
    size: tuple[float, ...], rise: float, look: Look, wall: Look, *, across: bool, eaves: float
) -> list[Mesh]:
    """The pitched roof of a house of this length, depth and height.

    `across` turns the gable to the street.
    """
    length, depth, height = size
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
    plain = replace(wall, params=(100.0, *wall.params[1:]))
    parts = []
    for side in (front, back):
        points = np.asarray(side)
        # u along the ridge, v down the slope: rows of tiles follow the eaves.
        along = points[3 if across else 1] - points[0]
        along = along / np.linalg.norm(along)
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        down = np.cross(normal / np.linalg.norm(normal), along)
        texture = np.stack([points @ along, points @ down, np.zeros(4)], axis=1)
        parts.append(polygon(points, look, texture=texture))
    for end in wall_ends:
        tip = at(end, middle, top)
        points = np.asarray([*(at(end, side, height) for side in walls_at), tip, tip])
        run, up = points[:, 0 if across else 1], points[:, 2] + 100.0
        texture = np.stack([run, np.full(4, 1.0), up], axis=1)
        parts.append(polygon(points, plain, texture=texture))
    return parts


def make_town_house(rng: Generator, length: float, *, shop: bool = False) -> Mesh:
    """A house of a closed row: front wall on y = 0 facing +y, from x = 0 to length."""
    style, color = _draw_wall(0.45, rng)
    floors, floor = int(rng.integers(2, 6)), rng.uniform(2.8, 3.4)
    ground = rng.uniform(3.4, 4.2) if shop else floor
    height, depth = ground + (floors - 1) * floor + 0.4, rng.uniform(8, 14)
    windows = rng.uniform((1.9, 0.36, 0.48), (3.2, 0.55, 0.62))
    look = _facade(color, windows, floor, (style, 1.0 if shop else 2.0, ground), rng)
    trim = _look(SurfaceKind.STONE, _tone(_TRIM, rng))
    roof = _look(SurfaceKind.ROOF, _tone(_ROOF, rng))
    if rng.random() < 0.6:
        rise = rng.uniform(2.0, 4.0)
        across = length < 9 and rng.random() < 0.25
        parts = _walls(length, depth, height, look)
        parts += _gable_roof((length, depth, height), rise, roof, look, across=across, eaves=0.4)
        if not across:
            at = (length * rng.uniform(0.1, 0.9), -depth / 2 + 0.4, height + rise)
            parts.append(box((0.9, 0.6, 2.0), at, _CHIMNEY))
            if rng.random() < 0.5:
                for x in np.arange(1.8, length - 1.2, 3.2):
                    parts.append(_dormer(x, height, rise, depth, look))
    else:
        parts = _walls(length, depth, height, look, roof)
        parts.append(box((length + 0.1, 0.3, 0.7), (length / 2, -0.1, height + 0.3), trim))
    if rng.random() < 0.7:
        parts.append(box((length, 0.35, 0.22), (length / 2, 0.12, height - 0.1), trim))
    if rng.random() < 0.4:
        parts.append(box((length, 0.14, 0.15), (length / 2, 0.04, ground), trim))
    if shop and rng.random() < 0.4:
        color = pick(_AWNING, rng)
        look = _look(SurfaceKind.PLANKS, color, 0.5, 0.9, rng.random())
        a, b, top, low = 0.6, length - 0.6, 3.0, 2.5
        corners = [(a, 0.02, top), (a, 1.3, low), (b, 1.3, low), (b, 0.02, top)]
        parts.append(polygon(corners, look))
    if not shop and rng.random() < 0.25:
        iron = _look(SurfaceKind.PLAIN, (0.12, 0.12, 0.12))
        for level in range(1, floors):
            z = ground + (level - 1) * floor + 0.15
            parts.append(box((2.2, 1.0, 0.14), (length / 2, 0.5, z), trim))
            parts.append(box((2.2, 0.04, 0.9), (length / 2, 0.98, z + 0.5), iron))
    return join(*parts)


def _look(kind: SurfaceKind, color: Color, *params: float) -> Look:
    return Look(kind, color, SceneClass.BUILDING, params)


_CHIMNEY = _look(SurfaceKind.BRICKWORK, (0.3, 0.15, 0.1))


def _facade(
    color: Color, windows: Iterable[float], floor: float, ground: tuple[float, ...], rng: Generator
) -> Look:
    """Return the look of the wall of a house.

    Args:
        color: colour of the wall.
        windows: width of a bay [m], and width and height of its window as shares of bay and floor.
        floor: height of a floor [m].
        ground: façade style of the ground floor (0 no openings, 1 shops or 2 doors), and its height
            [m].
        rng: source of random numbers.
    """
    bay, wide, tall = windows
    return _look(SurfaceKind.FACADE, color, bay, floor, wide, tall, *ground, rng.random())


def _draw_wall(bricks: float, rng: Generator) -> tuple[float, Color]:
    """Draw style and colour of a wall, which is of brick with this probability."""
    is_brick = rng.random() < bricks
    return float(is_brick), _tone(_BRICK if is_brick else _PLASTER, rng)


def _tone(colors: tuple[Color, ...], rng: Generator) -> Color:
    return vary(colors, rng, most=1.15, tint=0.06, limits=(0.02, 0.85))


def _dormer(x: float, height: float, rise: float, depth: float, wall: Look) -> Mesh:
    setback = depth * 0.12
    z = height + rise * setback / (depth / 2)
    window = (1.3, 1.4, 0.6, 0.65, PLASTER, 0.0, 0.0, wall.params[7])
    look = _look(SurfaceKind.FACADE, (0.5, 0.49, 0.46), *window)
    walls = join(*_walls(1.3, 1.6, 1.3, look)).moved(offset=(x - 0.65, -setback, z))
    lid = _look(SurfaceKind.PLAIN, (0.1, 0.1, 0.11))
    return join(walls, box((1.6, 1.9, 0.12), (x, -setback - 0.7, z + 1.36), lid))


def make_office(rng: Generator, length: float) -> Mesh:
    """A modern block with bands of windows and a flat roof."""
    floors, floor = int(rng.integers(3, 9)), rng.uniform(3.1, 3.6)
    height, depth = floors * floor + 0.8, rng.uniform(12, 18)
    color = _tone(_OFFICE, rng)
    windows = rng.uniform((1.2, 0.7, 0.45), (2.6, 0.94, 0.75))
    look = _facade(color, windows, floor, (OFFICE, float(rng.random() < 0.5), 3.8), rng)
    roof = _look(SurfaceKind.PLAIN, (0.25, 0.25, 0.25))
    lift = box((length * 0.3, depth * 0.4, 2.2), (length / 2, -depth / 2, height + 1.1), roof)
    return join(*_walls(length, depth, height, look, roof), lift)


def make_house(rng: Generator, length: float) -> Mesh:
    """A detached house with a pitched roof."""
    style, color = _draw_wall(0.5, rng)
    height, depth = 2.7 * int(rng.integers(1, 3)) + 0.4, rng.uniform(7, 10)
    windows = (*rng.uniform((2.2, 0.38), (3.4, 0.55)), 0.5)
    look = _facade(color, windows, 2.7, (style, 2.0, 2.7), rng)
    roof = _look(SurfaceKind.ROOF, _tone(_ROOF, rng))
    rise, across = rng.uniform(2.2, 3.6), rng.random() < 0.35
    slopes = _gable_roof((length, depth, height), rise, roof, look, across=across, eaves=0.5)
    chimney = box((0.7, 0.5, 2.4), (length * 0.8, -depth / 2 - 0.6, height + 2.6), _CHIMNEY)
    return join(*_walls(length, depth, height, look), *slopes, chimney)


def make_shed(rng: Generator, length: float) -> Mesh:
    """A warehouse or supermarket of ribbed sheet."""
    height, depth = rng.uniform(5, 9), rng.uniform(15, 25)
    color, ground_floor = _tone(_SHEET, rng), (SHED, float(rng.random() < 0.5), 3.6)
    look = _facade(color, (6.0, 0.8, 0.12), height * 0.8, ground_floor, rng)
    return join(*_walls(length, depth, height, look, _look(SurfaceKind.PLAIN, (0.3, 0.3, 0.3))))
