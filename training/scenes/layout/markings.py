"""The layout of road paint: lines, stop lines, crossings, arrows."""

from numpy.random import Generator

from training.scenes.layout.street_plan import END_M, Plan, lane_centre
from training.scenes.textures.paint import Stripe


def draw_stripes(rng: Generator, plan: Plan) -> list[Stripe]:
    """Centre and lane lines, edge lines, stop lines, zebra crossings."""
    stripes = []
    yellow = (0.55, 0.38, 0.04)
    center_solid = rng.random() < 0.25
    edge_line = plan.kind in ("highway", "avenue") or rng.random() < 0.3
    double_yellow = plan.side < 0 and plan.parking < 1 and rng.random() < 0.6
    wide = float(rng.uniform(0.05, 0.08))
    dash, share = float(rng.choice([6.0, 9.0, 12.0])), float(rng.choice([0.33, 0.5]))
    centre = plan.kind != "residential" or rng.random() < 0.4
    for a, b in plan.blocks(END_M, margin=2.5):
        if centre:
            solid = center_solid or plan.lanes > 1
            stripes.append(Stripe("s", 0.0, wide, a, b, 0.0 if solid else dash, share))
        for lane in range(1, plan.lanes):
            stripes += [
                Stripe("s", sign * lane * plan.lane, wide, a, b, dash, share) for sign in (-1, 1)
            ]
        edge = plan.lane * plan.lanes
        if plan.parking > 2:
            stripes += [Stripe("s", sign * edge, wide * 0.8, a, b, 1.2, 0.5) for sign in (-1, 1)]
        elif double_yellow:
            stripes += [
                Stripe("s", sign * (plan.kerb - off), 0.045, a, b, color=yellow)
                for sign in (-1, 1)
                for off in (0.25, 0.45)
            ]
        elif edge_line:
            stripes += [Stripe("s", sign * (edge - 0.05), wide, a, b) for sign in (-1, 1)]
    for c in plan.crossings:
        own = sorted((-plan.side * 0.3, -plan.side * (plan.lanes * plan.lane - 0.2)))
        far = sorted((plan.side * 0.3, plan.side * (plan.lanes * plan.lane - 0.2)))
        gap = plan.crossing_half + 2.0
        zebra = rng.random() < 0.5
        away = gap + (3.6 if zebra else 0.0)
        if rng.random() < 0.75:
            stripes.append(Stripe("d", c - away - 0.5, 0.18, own[0], own[1]))
            stripes.append(Stripe("d", c + away + 0.5, 0.18, far[0], far[1]))
        if zebra:
            k = plan.kerb - 0.3
            stripes += [
                Stripe("d", c + sign * (gap + 1.4), 1.4, -k, k, 1.0, 0.5) for sign in (-1, 1)
            ]
        for sign in (-1, 1):
            lo, hi = sorted((sign * (plan.kerb + 0.4), sign * 60.0))
            stripes.append(Stripe("d", c, 0.06, lo, hi, 4.0, 0.5))
            rim = sign * (plan.kerb + 0.5)
            half = plan.crossing_half
            stripes.append(Stripe("s", rim, 0.12, c - half + 0.2, c + half - 0.2, 0.8, 0.6))
    if plan.lanes > 1:
        for lane in range(plan.lanes):
            where = float(rng.uniform(8, 40))
            d = lane_centre(plan, lane)
            stripes.append(Stripe("s", d, 0.09, where, where + 3.2))
            stripes += [
                Stripe("s", d, 0.42 - 0.42 * k / 7, where + 3.2 + 0.24 * k, where + 3.44 + 0.24 * k)
                for k in range(7)
            ]
    return stripes
