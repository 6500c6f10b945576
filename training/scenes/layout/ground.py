"""The ground of a street: carriageway, kerbs, pavements, grass and side roads."""

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.classes import SceneClass
from training.scenes.layout.centreline import Centreline
from training.scenes.layout.street_plan import END_M, KERB_M, START_M, Plan
from training.scenes.textures.surface_kinds import SurfaceKind
from training.scenes.things.mesh import Look, Mesh, grid


def _ribbon(line: Centreline, s: Floats, edges: list[tuple[float, float]], look: Look) -> Mesh:
    """A strip along the street through points (d, up), listed from right to left."""
    d, up = np.array(edges).T
    points = line.at(s[:, None], d[None], up[None])
    texture = np.stack(np.broadcast_arrays(s[:, None], d[None], up[None]), axis=-1)
    return grid(points, look, texture=texture)


def make_ground(rng: Generator, plan: Plan, line: Centreline) -> list[Mesh]:
    tone = float(rng.uniform(0.07, 0.2))
    asphalt = Look(
        SurfaceKind.ASPHALT, (tone, tone, tone * 1.02), SceneClass.ROAD, (float(rng.random()),)
    )
    slab = float(rng.uniform(0.2, 0.36))
    paving = Look(
        SurfaceKind.PAVING,
        (slab, slab * rng.uniform(0.9, 1), slab * rng.uniform(0.8, 1)),
        SceneClass.PAVEMENT,
        (float(rng.choice([0.4, 0.6, 0.9, 50.0])), float(rng.random())),
    )
    kerb = Look(SurfaceKind.STONE, (0.4, 0.39, 0.37), SceneClass.PAVEMENT)
    grass = Look(SurfaceKind.GRASS, (0.09, 0.13, 0.035), SceneClass.TERRAIN, (float(rng.random()),))
    fore = Look(
        SurfaceKind.PAVING, (slab * 0.8, slab * 0.78, slab * 0.75), SceneClass.PAVEMENT, (0.5, 0.5)
    )
    whole = np.arange(START_M, END_M + 60, 3.0)
    parts = [
        _ribbon(line, whole, [(-plan.kerb, 0.0), (plan.kerb, 0.0)], asphalt),
        _ribbon(
            line,
            np.array([START_M - 20, *np.linspace(0, END_M, 40), END_M + 110]),
            [(-420.0, -2.0), (-80.0, -0.25), (80.0, -0.25), (420.0, -2.0)],
            grass,
        ),
    ]
    for a, b in plan.blocks(END_M + 60):
        s = np.linspace(a, b, max(2, int((b - a) / 3) + 1))
        for sign in (-1.0, 1.0):

            def strip(
                points: list[tuple[float, float]], look: Look, sign: float = sign, s: Floats = s
            ) -> Mesh:
                edges = [(sign * d, up) for d, up in points]
                return _ribbon(line, s, edges if sign > 0 else edges[::-1], look)

            k, p = plan.kerb, plan.back
            inner = k + 0.15
            if plan.kind == "highway" and not plan.pavement:
                parts.append(strip([(k, 0.0), (k + 4, -0.1), (60, -0.1)], grass))
                continue
            parts.append(strip([(k, -0.05), (k, KERB_M), (inner, KERB_M)], kerb))
            if plan.verge:
                parts.append(strip([(inner, KERB_M), (inner + plan.verge, KERB_M)], grass))
            parts.append(strip([(inner + plan.verge, KERB_M), (p, KERB_M)], paving))
            behind = fore if plan.kind in ("town", "square") else grass
            parts.append(strip([(p, KERB_M), (p + 8, KERB_M), (60, KERB_M - 0.05)], behind))
    for c in plan.crossings:
        s = np.array([c - plan.crossing_half, c + plan.crossing_half])
        for sign in (-1, 1):
            d = np.linspace(plan.kerb, 110, 12) * sign
            edges = [(float(x), 0.0) for x in (d if sign > 0 else d[::-1])]
            parts.append(_ribbon(line, s, edges, asphalt))
            for edge in (-1, 1):
                wall = c + edge * plan.crossing_half
                run = np.array([wall - 0.07, wall + 0.07])
                end = [(sign * plan.kerb, 0.13), (sign * 60.0, 0.13)]
                parts.append(_ribbon(line, run, end if sign > 0 else end[::-1], kerb))
    return parts
