"""Placing a mesh in a street."""

import numpy as np

from training.scenes.layout.centreline import Centreline
from training.scenes.things.mesh import Mesh


def place(line: Centreline, mesh: Mesh, s: float, d: float, up: float, turned: float) -> Mesh:
    heading = float(line.heading_at(s)) + turned
    return mesh.moved(heading=heading, offset=line.at(s, d, up))


def facing(sign: float) -> float:
    """Return the rotation by which the +y side of a mesh faces the road from side `sign`."""
    return np.pi if sign > 0 else 0.0
