"""The ground of a street: carriageway, kerbs, pavements, grass and side roads."""

import numpy as np

from training.scenes.arrays import Floats
from training.scenes.layout.site import END_M, KERB_M, START_M, Centreline, Site
from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, Mesh, grid

Edges = list[tuple[float, float]]


def _ribbon(line: Centreline, s: Floats, edges: Edges, look: Look, *, sign: float = 1.0) -> Mesh:
    """Make a strip along the street through edges (d, up), from right to left; sign -1 mirrors."""
    d, up = np.array(edges if sign > 0 else edges[::-1]).T
    d = sign * d
    points = line.at(s[:, None], d[None], up[None])
    texture = np.stack(np.broadcast_arrays(s[:, None], d[None], up[None]), axis=-1)
    return grid(points, look, texture=texture)


def make_ground(site: Site) -> list[Mesh]:
    rng, plan, line = site.rng, site.plan, site.line
    label, tone = SceneClass.PAVEMENT, rng.uniform(0.07, 0.2)
    grey = tone, tone, tone * 1.02
    asphalt = Look(SurfaceKind.ASPHALT, grey, SceneClass.ROAD, (rng.random(),))
    slab = rng.uniform(0.2, 0.36)
    color = slab, slab * rng.uniform(0.9, 1), slab * rng.uniform(0.8, 1)
    pitch = float(rng.choice([0.4, 0.6, 0.9, 50.0]))
    paving = Look(SurfaceKind.PAVING, color, label, (pitch, rng.random()))
    kerb = Look(SurfaceKind.STONE, (0.4, 0.39, 0.37), label)
    grass = Look(SurfaceKind.GRASS, (0.09, 0.13, 0.035), SceneClass.TERRAIN, (rng.random(),))
    fore = Look(SurfaceKind.PAVING, (slab * 0.8, slab * 0.78, slab * 0.75), label, (0.5, 0.5))
    k, p = plan.kerb, plan.back
    whole = np.arange(START_M, END_M + 60, 3.0)
    wide = np.array([START_M - 20, *np.linspace(0, END_M, 40), END_M + 110])
    meadow = [(-420.0, -2.0), (-80.0, -0.25), (80.0, -0.25), (420.0, -2.0)]
    parts = [_ribbon(line, whole, [(-k, 0.0), (k, 0.0)], asphalt)]
    parts.append(_ribbon(line, wide, meadow, grass))
    inner = k + 0.15
    strips: list[tuple[Edges, Look]]
    if plan.kind == "highway" and not plan.pavement:
        strips = [([(k, 0.0), (k + 4, -0.1), (60, -0.1)], grass)]
    else:
        strips = [([(k, -0.05), (k, KERB_M), (inner, KERB_M)], kerb)]
        if plan.verge:
            strips.append(([(inner, KERB_M), (inner + plan.verge, KERB_M)], grass))
        strips.append(([(inner + plan.verge, KERB_M), (p, KERB_M)], paving))
        behind = fore if plan.kind in ("town", "square") else grass
        strips.append(([(p, KERB_M), (p + 8, KERB_M), (60, KERB_M - 0.05)], behind))
    for a, b in plan.blocks(END_M + 60):
        s = np.linspace(a, b, max(2, int((b - a) / 3) + 1))
        for sign in (-1.0, 1.0):
            parts += [_ribbon(line, s, edges, look, sign=sign) for edges, look in strips]
    for c in plan.crossings:
        walls = c - plan.crossing_half, c + plan.crossing_half
        for sign in (-1.0, 1.0):
            edges = [(float(d), 0.0) for d in np.linspace(k, 110, 12)]
            parts.append(_ribbon(line, np.array(walls), edges, asphalt, sign=sign))
            for wall in walls:
                run = np.array([wall - 0.07, wall + 0.07])
                parts.append(_ribbon(line, run, [(k, 0.13), (60.0, 0.13)], kerb, sign=sign))
    return parts
