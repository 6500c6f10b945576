"""Placing a mesh in a street."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from training.scenes.layout.centreline import Centreline
from training.scenes.layout.street_plan import Plan
from training.scenes.things.mesh import Mesh


@dataclass(frozen=True)
class Site:
    """A street under construction: its random numbers, cross-section and centre line."""

    rng: Generator
    plan: Plan
    line: Centreline

    def place(self, mesh: Mesh, s: float, d: float, up: float = 0.0, turned: float = 0.0) -> Mesh:
        """Return the mesh at street coordinates, turned relative to the street [rad]."""
        heading = float(self.line.heading_at(s)) + turned
        return mesh.moved(heading=heading, offset=self.line.at(s, d, up))

    def draw_turn(self) -> float:
        """Draw any heading [rad]."""
        return float(self.rng.uniform(0, 6.3))


def facing(sign: float) -> float:
    """Return the rotation by which the +y side of a mesh faces the road from side `sign`."""
    return np.pi if sign > 0 else 0.0
