"""The layout of road paint: lines, stop lines, crossings, arrows."""

from numpy.random import Generator

from training.scenes.layout.site import END_M, Plan
from training.scenes.textures.paint import Stripe


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
