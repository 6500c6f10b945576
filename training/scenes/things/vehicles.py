"""Cars, vans, buses and trucks: lofted bodies with wheels, glass and mirrors."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Color, Look, Mesh, box, grid, join, pick, rows, tube, vary

_PAINTS = rows(
    "0.55 0.56 0.57, 0.75 0.75 0.74, 0.03 0.03 0.035, 0.12 0.13 0.14, 0.3 0.31 0.32, "
    "0.45 0.03 0.03, 0.03 0.07 0.25, 0.05 0.1 0.16, 0.02 0.12 0.07, 0.2 0.02 0.03, "
    "0.5 0.47 0.38, 0.06 0.2 0.42, 0.6 0.35 0.03, 0.18 0.19 0.2, 0.82 0.82 0.82"
)

# Lamps and tyres of lorries and buses.
_RED = Look(SurfaceKind.GLOW, (0.5, 0.02, 0.02), SceneClass.TRUCK, (0.4,))
_WHITE = Look(SurfaceKind.GLOW, (0.7, 0.7, 0.65), SceneClass.TRUCK, (0.3,))
_TYRE = Look(SurfaceKind.WHEEL, (0.3, 0.3, 0.31), SceneClass.TRUCK, (0.48, 0.2))


@dataclass(frozen=True)
class CarShape:
    """Side profile of a car body.

    Attributes:
        outline: fractions of the length, and heights [m].
        sizes: length, width, height of the belt line and radius of the wheels [m].
        rear_glass, windscreen: beginning and end, as fractions of the length from the tail.
        wheels, pillars: positions, as fractions of the length from the tail.
    """

    outline: tuple[tuple[float, ...], ...]
    sizes: tuple[float, ...]
    rear_glass: tuple[float, ...]
    windscreen: tuple[float, ...]
    wheels: tuple[float, ...]
    pillars: tuple[float, ...]


def _shape(places: str, outline: str) -> CarShape:
    return CarShape(rows(outline), *rows(places))


_HATCHBACK = _shape(
    "4.1 1.74 0.93 0.32, 0.03 0.13, 0.6 0.76, 0.185 0.8, 0.2 0.44",
    "0 0.62, 0.015 0.92, 0.03 0.98, 0.13 1.40, 0.22 1.47, 0.5 1.47, "
    "0.6 1.38, 0.76 0.99, 0.93 0.84, 0.985 0.7, 1 0.6",
)
_SEDAN = _shape(
    "4.6 1.8 0.93 0.32, 0.14 0.27, 0.58 0.72, 0.2 0.81, 0.24 0.45",
    "0 0.6, 0.012 0.9, 0.03 0.98, 0.14 1.03, 0.27 1.36, 0.38 1.43, "
    "0.52 1.43, 0.58 1.37, 0.72 1.0, 0.93 0.83, 0.985 0.7, 1 0.58",
)
_ESTATE = _shape(
    "4.7 1.8 0.95 0.32, 0.025 0.09, 0.58 0.72, 0.2 0.81, 0.22 0.44",
    "0 0.6, 0.012 0.95, 0.025 1.0, 0.09 1.38, 0.14 1.47, 0.5 1.48, "
    "0.58 1.4, 0.72 1.02, 0.93 0.85, 0.985 0.7, 1 0.58",
)
_SUV = _shape(
    "4.5 1.86 1.08 0.37, 0.025 0.09, 0.6 0.72, 0.19 0.81, 0.22 0.45",
    "0 0.7, 0.012 1.05, 0.025 1.1, 0.09 1.6, 0.15 1.7, 0.52 1.7, "
    "0.6 1.6, 0.72 1.16, 0.94 1.05, 0.985 0.85, 1 0.7",
)
_VAN = _shape(
    "5.3 2.0 1.22 0.36, 0.01 0.02, 0.74 0.87, 0.17 0.82, 0.64",
    "0 0.7, 0.006 1.2, 0.01 1.25, 0.02 2.2, 0.05 2.35, 0.68 2.35, "
    "0.74 2.2, 0.87 1.25, 0.96 1.05, 0.99 0.85, 1 0.6",
)
_TRUCK_CAB = _shape(
    "2.3 2.45 1.45 0.48, 0 0, 0.8 0.95, 0.45 0.45, 0.3",
    "0 0.9, 0.01 2.5, 0.05 2.75, 0.7 2.75, 0.8 2.65, 0.95 1.5, 0.99 1.2, 1 0.6",
)
_CARGO_PAINTS = rows("0.7 0.7 0.68, 0.5 0.5 0.52, 0.4 0.05 0.04, 0.06 0.15 0.35, 0.6 0.45 0.1")
_BUS_PAINTS = rows("0.5 0.04 0.03, 0.7 0.68 0.6, 0.05 0.2 0.45, 0.1 0.35 0.12, 0.65 0.5 0.05")
_VAN_PAINTS = ((0.75, 0.75, 0.73), *_PAINTS[:4])
_CARS = (_HATCHBACK, _HATCHBACK, _SEDAN, _ESTATE, _SUV)


def make_car(rng: Generator) -> Mesh:
    """A passenger car in its own frame: x forward, y left, z up, wheels on z = 0."""
    shape, paint = pick(_CARS, rng), _draw_paint(_PAINTS, rng)
    return _bodied(shape, paint, SceneClass.CAR, rng, size=rng.uniform(0.95, 1.06))


def make_van(rng: Generator) -> Mesh:
    """A delivery van or minibus."""
    paint = _draw_paint(_VAN_PAINTS, rng)
    return _bodied(_VAN, paint, SceneClass.VAN, rng, size=rng.uniform(0.88, 1.05))


def _draw_paint(paints: tuple[Color, ...], rng: Generator) -> Color:
    return vary(paints, rng, most=1.2, tint=0.05, limits=(0.015, 0.85))


def _bodied(shape: CarShape, paint: Color, label: SceneClass, rng: Generator, size: float) -> Mesh:
    length, width, belt_line, radius = shape.sizes
    half = width / 2
    fx = np.array(sorted({*(f for f, _ in shape.outline), *np.linspace(0.05, 0.95, 13)}))
    top = np.interp(fx, *np.array(shape.outline).T)
    x = (fx - 0.5) * length
    belt = np.minimum(belt_line, top - 0.02)
    cabin = top - belt
    # Nose and tail are rounded in plan; the greenhouse leans inwards with its height.
    plan = half * (1 - 0.16 * np.abs(2 * fx - 1) ** 5)
    upper = plan * 0.97 - 0.26 * cabin
    floor = np.full_like(x, 0.22 if label == SceneClass.CAR else 0.3)
    section = [
        (plan * 0.55, floor),
        (plan * 0.93, floor + 0.02),
        (plan, floor + 0.18),
        (plan * 1.005, belt * 0.72),
        (plan * 0.97, belt),
        (upper, belt + cabin * 0.9),
        (upper * 0.86, top),
        (upper * 0.4, top + 0.02),
        (upper * 0.0, top + 0.025),
    ]
    right = np.stack([np.stack([x, -y, z], 1) for y, z in section], 1)
    # The last column closes the loop under the floor: (stations, 18, 3).
    lattice = np.concatenate([right, right[:, -2::-1] * (1, -1, 1), right[:, :1]], axis=1)
    seed = rng.random()
    ends = shape.wheels, shape.pillars
    wheel_x, pillars = ([(f - 0.5) * length for f in each] for each in ends)
    params = (*wheel_x, radius, length, width, belt_line, pillars[-1], seed)
    body = Look(SurfaceKind.CAR_BODY, paint, label, params)
    # Delivery vans have windows at the cab only.
    cab = pillars[:1] if label == SceneClass.VAN and seed < 0.75 else []
    panes = (*[*pillars, 99.0][:2], seed, *cab)
    side = Look(SurfaceKind.CAR_SIDE_WINDOW, paint, label, panes)
    glass = Look(SurfaceKind.CAR_GLASS, (0.02, 0.025, 0.03), label, (seed,))
    up = np.concatenate([np.zeros(4), [0.0, 1.0], np.full(5, 1.0), [1.0, 0.0], np.zeros(5)])
    on_window = np.stack(np.broadcast_arrays(lattice[..., 0], cabin[:, None], up), axis=-1)
    strip, middle = np.broadcast_arrays(np.arange(17), ((fx[:-1] + fx[1:]) / 2)[:, None])

    def between(low: float, high: float) -> Floats:
        return np.asarray((middle > low) & (middle < high))

    is_side = between(shape.rear_glass[0], shape.windscreen[1]) & np.isin(strip, (4, 11))
    is_glass = between(*shape.rear_glass) | between(*shape.windscreen)
    is_glass &= np.isin(strip, (6, 7, 8, 9))
    if label == SceneClass.VAN and seed < 0.5:
        is_glass &= middle > 0.5
    part = np.repeat(np.where(is_side, 1, np.where(is_glass, 2, 0)).ravel(), 2)
    parts = [
        grid(lattice, body, smooth=True).take(part == 0),
        grid(lattice, side, texture=on_window, smooth=True).take(part == 1),
        grid(lattice, glass, smooth=True).take(part == 2),
    ]
    for ring, order in ((lattice[0], 1), (lattice[-1], -1)):
        lid = np.stack([ring, np.broadcast_to(ring.mean(axis=0), ring.shape)])
        parts.append(grid(lid[::order], body))
    tyre = Look(SurfaceKind.WHEEL, (0.45, 0.45, 0.46), label, (radius, seed))
    parts += [_wheel(x, sign * (half - 0.10), tyre) for x in wheel_x for sign in (-1, 1)]
    mirror = Look(SurfaceKind.PLAIN, paint, label, (0.3,))
    mirror_x = (shape.windscreen[1] - 0.5) * length - 0.35
    places = [(mirror_x, sign * (half + 0.06), belt_line + 0.1) for sign in (-1, 1)]
    parts += [box((0.12, 0.2, 0.14), place, mirror) for place in places]
    return join(*parts).scaled(size)


def _wheel(x: float, y: float, look: Look) -> Mesh:
    radius = look.params[0]
    wheel = tube((0, -0.11, 0), (0, 0.11, 0), (radius, radius), look, sides=20)
    return wheel.moved(offset=(x, y, radius))


def make_truck(rng: Generator) -> Mesh:
    """A rigid lorry: cab, cargo box (plain, striped or tank), chassis and wheels."""
    label, length = SceneClass.TRUCK, rng.uniform(6.5, 10.5)
    cab_paint, box_paint = _draw_paint(_PAINTS, rng), _draw_paint(_CARGO_PAINTS, rng)
    cab = _bodied(_TRUCK_CAB, cab_paint, label, rng, size=1.0)
    dark = Look(SurfaceKind.PLAIN, (0.03, 0.03, 0.03), label, (0.2,))
    cargo_length, height, rear = length - 2.6, rng.uniform(2.2, 2.8), -length / 2
    parts = [
        cab.moved(offset=(length / 2 - 1.15, 0, 0.05)),
        box((length - 0.6, 1.0, 0.3), (-0.2, 0, 0.75), dark),
    ]
    if rng.random() < 0.2:
        tank = Look(SurfaceKind.METAL, (0.6, 0.6, 0.6), label)
        ends = (rear, 0, 2.05), (rear + cargo_length, 0, 2.05)
        parts.append(tube(*ends, (1.15, 1.15), tank, sides=24))
    else:
        cargo = Look(SurfaceKind.PLANKS, box_paint, label, (1.2, 0.25, rng.random()))
        middle = (rear + cargo_length / 2, 0, 1.0 + height / 2)
        parts.append(box((cargo_length, 2.45, height), middle, cargo))
    for sign in (-1, 1):
        parts.append(box((0.08, 0.3, 0.14), (rear - 0.03, sign * 1.0, 0.85), _RED))
        parts.append(_wheel(rear + 1.6, sign * 1.08, _TYRE))
        parts.append(box((1.2, 0.05, 0.25), (rear + 0.6, sign * 1.2, 0.65), dark))
    plate = Look(SurfaceKind.PLAIN, (0.6, 0.6, 0.55), label)
    parts.append(box((0.06, 2.3, 0.16), (rear - 0.02, 0, 0.6), dark))
    return join(*parts, box((0.04, 0.5, 0.12), (rear - 0.05, 0, 0.6), plate))


def make_bus(rng: Generator) -> Mesh:
    """A city bus; its class is Truck, the nearest one of Virtual KITTI 2."""
    length, width, height = 11.0, 2.5, float(rng.choice([2.9, 4.1]))
    paint, front = _draw_paint(_BUS_PAINTS, rng), length / 2
    params = (height, length, width, rng.random())
    side = Look(SurfaceKind.BUS_SIDE, paint, SceneClass.TRUCK, params)
    parts = [box((length, width, height - 0.3), (0, 0, 0.3 + (height - 0.3) / 2), side)]
    tyre = replace(_TYRE, params=(0.48, 0.1))
    for x in (-front + 2.8, front - 2.6):
        parts += [_wheel(x, sign * (width / 2 - 0.08), tyre) for sign in (-1, 1)]
    for sign in (-1, 1):
        parts.append(box((0.06, 0.25, 0.25), (-front - 0.02, sign * 1.0, 0.9), _RED))
        parts.append(box((0.06, 0.3, 0.2), (front + 0.02, sign * 0.95, 0.75), _WHITE))
    return join(*parts)
