"""The ground of a street: carriageway, kerbs, pavements, grass, side roads, and road paint."""

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.layout.site import END_M, KERB_M, START_M, Plan, Site
from training.scenes.names import SceneClass
from training.scenes.textures.patterns import Stripe
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Look, grid

Edges = list[tuple[float, float]]


def _lay(site: Site, s: Floats, edges: Edges, look: Look, *, sign: float = 1.0) -> None:
    """Add a strip along the street through edges (d, up), from right to left; sign -1 mirrors."""
    d, up = np.array(edges if sign > 0 else edges[::-1]).T
    d = sign * d
    points = site.line.at(s[:, None], d[None], up[None])
    texture = np.stack(np.broadcast_arrays(s[:, None], d[None], up[None]), axis=-1)
    site.meshes.append(grid(points, look, texture=texture))


def make_ground(site: Site) -> None:
    """Make carriageway, kerbs, pavements, grass and side roads."""
    rng, plan = site.rng, site.plan
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
    _lay(site, whole, [(-k, 0.0), (k, 0.0)], asphalt)
    _lay(site, wide, meadow, grass)
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
            for edges, look in strips:
                _lay(site, s, edges, look, sign=sign)
    for c in plan.crossings:
        walls = c - plan.crossing_half, c + plan.crossing_half
        for sign in (-1.0, 1.0):
            edges = [(float(d), 0.0) for d in np.linspace(k, 110, 12)]
            _lay(site, np.array(walls), edges, asphalt, sign=sign)
            for wall in walls:
                run = np.array([wall - 0.07, wall + 0.07])
                _lay(site, run, [(k, 0.13), (60.0, 0.13)], kerb, sign=sign)


def _pair(d: float, wide: float, a: float, b: float, *dashes: float) -> list[Stripe]:
    """Return a stripe from a to b along the street on both sides of its centre line."""
    period, share = dashes or (0.0, 1.0)
    return [Stripe("s", sign * d, wide, a, b, period, share) for sign in (-1, 1)]


def draw_stripes(rng: Generator, plan: Plan) -> list[Stripe]:
    """Draw centre and lane lines, edge lines, stop lines and zebra crossings."""
    stripes = []
    center_solid = rng.random() < 0.25
    edge_line = plan.kind in ("highway", "avenue") or rng.random() < 0.3
    double_yellow = plan.side < 0 and plan.parking < 1 and rng.random() < 0.6
    wide, edge = rng.uniform(0.05, 0.08), plan.lane * plan.lanes
    dash, share = float(rng.choice([6.0, 9.0, 12.0])), float(rng.choice([0.33, 0.5]))
    centre = plan.kind != "residential" or rng.random() < 0.4
    for a, b in plan.blocks(END_M, margin=2.5):
        if centre:
            solid = center_solid or plan.lanes > 1
            stripes.append(Stripe("s", 0.0, wide, a, b, 0.0 if solid else dash, share))
        for lane in range(1, plan.lanes):
            stripes += _pair(lane * plan.lane, wide, a, b, dash, share)
        if plan.parking > 2:
            stripes += _pair(edge, wide * 0.8, a, b, 1.2, 0.5)
        elif double_yellow:
            inner, outer = plan.kerb - 0.45, plan.kerb - 0.25
            stripes += [
                Stripe("s", d, 0.045, a, b, color=(0.55, 0.38, 0.04))
                for d in (-outer, -inner, outer, inner)
            ]
        elif edge_line:
            stripes += _pair(edge - 0.05, wide, a, b)
    for c in plan.crossings:
        low, high = sorted((plan.side * 0.3, plan.side * (edge - 0.2)))
        half = plan.crossing_half
        gap = half + 2.0
        zebra = rng.random() < 0.5
        away = gap + (3.6 if zebra else 0.0)
        if rng.random() < 0.75:
            stripes.append(Stripe("d", c - away - 0.5, 0.18, -high, -low))
            stripes.append(Stripe("d", c + away + 0.5, 0.18, low, high))
        if zebra:
            k = plan.kerb - 0.3
            for middle in (c - (gap + 1.4), c + (gap + 1.4)):
                stripes.append(Stripe("d", middle, 1.4, -k, k, 1.0, 0.5))
        for sign in (-1, 1):
            near, far = sorted((sign * (plan.kerb + 0.4), sign * 60.0))
            stripes.append(Stripe("d", c, 0.06, near, far, 4.0, 0.5))
            rim = sign * (plan.kerb + 0.5)
            stripes.append(Stripe("s", rim, 0.12, c - half + 0.2, c + half - 0.2, 0.8, 0.6))
    if plan.lanes > 1:
        for lane in range(plan.lanes):
            where, d = rng.uniform(8, 40), plan.lane_centre(lane)
            stripes.append(Stripe("s", d, 0.09, where, where + 3.2))
            for k in range(7):
                start, end = where + 3.2 + 0.24 * k, where + 3.44 + 0.24 * k
                stripes.append(Stripe("s", d, 0.42 - 0.42 * k / 7, start, end))
    return stripes
