"""Putting a thing down at a place of the street."""

import numpy as np

from training.scenes.layout.centreline import Centreline
from training.scenes.things.mesh import Mesh


def place(line: Centreline, mesh: Mesh, s: float, d: float, up: float, turned: float) -> Mesh:
    heading = float(line.heading_at(s)) + turned
    return mesh.moved(heading=heading, offset=line.at(s, d, up))


def facing(sign: float) -> float:
    """Turn that makes a thing with its front on +y face the road from side `sign`."""
    return np.pi if sign > 0 else 0.0
