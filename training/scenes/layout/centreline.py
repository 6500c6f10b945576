"""The centre line of a street, and the map from street coordinates to the world."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats


@dataclass(frozen=True)
class Centreline:
    """Centre of a street sampled every metre; s is the way along it, d the distance to its left.

    All arrays (n,): s [m], x, y, z [m], heading [rad].
    """

    s: Floats
    x: Floats
    y: Floats
    z: Floats
    heading: Floats

    def at(self, s: float | Floats, d: float | Floats, up: float | Floats = 0.0) -> Floats:
        """World points (..., 3) of street coordinates; up is metres above the road."""
        along = np.asarray(s, dtype=np.float64)
        heading = self.heading_at(along)
        return np.stack(
            np.broadcast_arrays(
                np.interp(along, self.s, self.x) - np.sin(heading) * d,
                np.interp(along, self.s, self.y) + np.cos(heading) * d,
                np.interp(along, self.s, self.z) + up,
            ),
            axis=-1,
        )

    def heading_at(self, s: float | Floats) -> Floats:
        """Direction of the street in rad, anticlockwise from the x axis."""
        return np.asarray(np.interp(np.asarray(s), self.s, self.heading))


def draw_centreline(rng: Generator, *, start: float, end: float, bend: float) -> Centreline:
    """A gently curving, gently rolling street; bend 0 is straight, 1 curves with radii of 150 m."""
    s = np.arange(start, end + 1.0)
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
