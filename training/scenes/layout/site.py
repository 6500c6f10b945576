"""The site of a street: its cross-section, its centre line, and the places of things along it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.names import StreetKind
from training.scenes.things.mesh import Mesh

# Height of the kerbs, and where streets start and end.
KERB_M = 0.12
START_M = -40.0
END_M = 330.0


@dataclass(frozen=True)
class Plan:
    """Cross-section of the street, in metres from the centre line.

    With `side` +1 traffic keeps right, with -1 it keeps left. Own lanes are at -side * d.
    """

    kind: StreetKind
    side: float
    lane: float
    lanes: int
    parking: float
    verge: float
    pavement: float
    crossings: tuple[float, ...]
    crossing_half: float

    @property
    def kerb(self) -> float:
        """Distance of the kerbs from the centre line."""
        return self.lane * self.lanes + self.parking

    @property
    def back(self) -> float:
        """Distance of the plots behind the pavement."""
        return self.kerb + self.verge + self.pavement

    def blocks(self, end: float, margin: float = 0.0) -> list[tuple[float, float]]:
        """Start and end of each block between side roads, from `START_M` to `end`."""
        starts = [START_M, *(c + self.crossing_half + margin for c in self.crossings)]
        ends = [*(c - self.crossing_half - margin for c in self.crossings), end]
        return list(zip(starts, ends, strict=True))

    def lane_centre(self, lane: int) -> float:
        """Centre of an own lane. Lane 0 is next to the centre line; the oncoming one is at -d."""
        return -self.side * self.lane * (lane + 0.5)

    def free(self, s: float, margin: float = 0.0) -> bool:
        """Whether s is clear of every side road."""
        return all(abs(s - c) > self.crossing_half + margin for c in self.crossings)


def draw_plan(rng: Generator, kind: StreetKind, side: float) -> Plan:
    """Draw the cross-section of a street, and where its side roads are."""
    avenue, highway, square = (int(rng.integers(1, end)) for end in (3, 3, 4))
    lanes = {"avenue": avenue, "highway": highway, "square": square}.get(kind, 1)
    lane = rng.uniform(3.0, 3.7)
    parking = 1.5 if kind == "highway" else 0.5
    if kind in ("town", "residential") and rng.random() < 0.7:
        parking = 2.2
    verges = {"residential": float(rng.choice([0.0, 1.5])), "avenue": rng.uniform(1.5, 4)}
    pavement = 0.0 if kind == "highway" and rng.random() < 0.6 else rng.uniform(1.8, 4.5)
    crossings: list[float] = []
    where = rng.uniform(12, 70)
    while where < 260 and kind != "highway":
        crossings.append(where)
        where += rng.uniform(45, 120)
    if kind == "highway" and rng.random() < 0.3:
        crossings = [rng.uniform(40, 90)]
    verge, half = verges.get(kind, 0.0), rng.uniform(3.2, 5.5)
    return Plan(kind, side, lane, lanes, parking, verge, pavement, tuple(crossings), half)


@dataclass(frozen=True)
class Centreline:
    """Centre of a street sampled every metre; s is the way along it, d the distance to its left.

    Attributes:
        s: way along the street [m], (n,), like the others.
        x, y, z: position [m].
        heading: direction [rad].
    """

    s: Floats
    x: Floats
    y: Floats
    z: Floats
    heading: Floats

    def at(self, s: float | Floats, d: float | Floats, up: float | Floats = 0.0) -> Floats:
        """World points (..., 3) of street coordinates; `up` is in metres above the road."""
        along = np.asarray(s, dtype=np.float64)
        heading = self.heading_at(along)
        x, y, z = (np.interp(along, self.s, values) for values in (self.x, self.y, self.z))
        moved = x - np.sin(heading) * d, y + np.cos(heading) * d, z + up
        return np.stack(np.broadcast_arrays(*moved), axis=-1)

    def heading_at(self, s: float | Floats) -> Floats:
        """Direction of the street [rad], anticlockwise from the x axis."""
        return np.asarray(np.interp(np.asarray(s), self.s, self.heading))


def draw_centreline(rng: Generator, bend: float) -> Centreline:
    """Draw a gently curving and rolling street; bend 0 is straight, 1 has radii of 150 m."""
    s = np.arange(START_M - 30, END_M + 121.0)
    curvature = np.zeros_like(s)
    for period in (140.0, 260.0):
        curvature += np.sin(2 * np.pi * s / period + rng.uniform(0, 6.3)) * rng.uniform(-1, 1)
    curvature *= bend / 200.0
    heading = np.cumsum(curvature)
    heading -= np.interp(0.0, s, heading)
    x, y = np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))
    slope = rng.uniform(0, 0.02) * np.sin(2 * np.pi * s / rng.uniform(150, 300) + rng.uniform(0, 6))
    z = np.cumsum(slope)
    at_zero = [np.interp(0.0, s, values) for values in (x, y, z)]
    return Centreline(s, x - at_zero[0], y - at_zero[1], z - at_zero[2], heading)


@dataclass(frozen=True)
class Site:
    """A street under construction: its random numbers, cross-section, centre line and meshes."""

    rng: Generator
    plan: Plan
    line: Centreline
    meshes: list[Mesh] = field(default_factory=list)

    def place(self, mesh: Mesh, s: float, d: float, up: float = 0.0, turned: float = 0.0) -> None:
        """Add a mesh at street coordinates, turned relative to the street [rad]."""
        heading = float(self.line.heading_at(s)) + turned
        self.meshes.append(mesh.moved(heading=heading, offset=self.line.at(s, d, up)))

    def draw_turn(self) -> float:
        """Draw any heading [rad]."""
        return self.rng.uniform(0, 6.3)


def facing(sign: float) -> float:
    """Return the rotation by which the +y side of a mesh faces the road from side `sign`."""
    return np.pi if sign > 0 else 0.0
