"""Buildings, gardens and trees along a street, and its horizon."""

import numpy as np
from numpy.random import Generator

from training.scenes.layout.site import END_M, KERB_M, START_M, Site, facing
from training.scenes.names import StreetKind
from training.scenes.things import buildings, furniture, plants
from training.scenes.things.mesh import Mesh, pick


class _Nursery:
    """The plants of a street; its trees are detailed near its start, coarse in the distance."""

    def __init__(self, rng: Generator) -> None:
        bare = [plants.make_bare_tree(rng) for _ in range(2)] if rng.random() < 0.35 else []
        near = [*(plants.make_tree(rng) for _ in range(4)), plants.make_conifer(rng)]
        far = [plants.make_tree(rng, leaf_count=700) for _ in range(4)]
        far.append(plants.make_conifer(rng, leaf_count=500))
        self.bushes = [plants.make_bush(rng) for _ in range(3)]
        self._rng, self._near, self._far = rng, near + bare, far + bare

    def draw_tree(self, s: float) -> Mesh:
        """Draw a tree for the place s along the street."""
        return pick(self._near if s < 75 else self._far, self._rng)


# Kinds of garden edges, each up to a cumulative share of all; the remaining gardens are open.
_EDGES = (
    (0.3, plants.make_hedge),
    (0.55, furniture.make_board_fence),
    (0.75, furniture.make_wall),
    (0.9, furniture.make_railing),
)
# Share of the plots that have trees instead of a building.
_GREEN = {"town": 0.1, "residential": 0.35, "avenue": 0.55, "highway": 0.85, "square": 0.45}


def make_frontage(site: Site) -> None:
    """Make buildings, gardens and trees behind the pavement on both sides."""
    rng, plan = site.rng, site.plan
    nursery, half = _Nursery(rng), plan.crossing_half
    gaps = [(c - half - 2.5, c + half + 2.5) for c in plan.crossings]
    narrow = plan.kind in ("town", "residential")
    for sign in (-1.0, 1.0):
        share = np.clip(_GREEN[plan.kind] + rng.normal(0, 0.15), 0, 1)
        home, avenue, square = rng.uniform((3, 2, 4), (7, 10, 15)).tolist()
        set_backs = {"residential": home, "avenue": avenue, "square": square, "highway": 14.0}
        s = START_M + rng.uniform(0, 8)
        while s < END_M:
            length = rng.uniform(6, 16) if narrow else rng.uniform(12, 34)
            blocked = [gap for gap in gaps if s < gap[1] and s + length > gap[0]]
            if blocked:
                length = blocked[0][0] - s
                if length < 5:
                    s = blocked[0][1]
                    continue
            if rng.random() < share:
                _grove(site, s, length, sign, nursery)
            else:
                _plot(site, s, length, sign, set_backs.get(plan.kind, 0.0), nursery)
            s += length + (0.02 if plan.kind == "town" else rng.uniform(0.5, 5))
        for c in plan.crossings:
            _side_road(site, c, sign, nursery)
    if plan.verge or plan.kind in ("square", "avenue") or rng.random() < 0.25:
        spacing = rng.uniform(8, 18)
        d = plan.kerb + (plan.verge / 2 if plan.verge else 0.9)
        for sign in (-1.0, 1.0):
            for s in np.arange(START_M, 220, spacing) + rng.uniform(0, 6):
                if plan.free(s, 3) and rng.random() < 0.75:
                    tree = nursery.draw_tree(s).scaled(rng.uniform(0.6, 0.9))
                    site.place(tree, s, sign * d, KERB_M, site.draw_turn())


def _make_building(rng: Generator, kind: StreetKind, length: float) -> Mesh:
    """Make a building that suits a kind of street."""
    draw = rng.random()
    shop = kind != "residential" and (kind != "town" or draw < 0.55)
    if kind == "town":
        other = buildings.make_office if length > 11 and rng.random() < 0.3 else None
    elif kind == "residential":
        other = buildings.make_house if draw < 0.75 else None
    else:
        large = (0.5, buildings.make_office), (0.75, None), (1.0, buildings.make_shed)
        other = next(make for share, make in large if draw < share)
    return other(rng, length) if other else buildings.make_town_house(rng, length, shop=shop)


def _plot(
    site: Site, s: float, length: float, sign: float, set_back: float, nursery: _Nursery
) -> None:
    rng, plan = site.rng, site.plan
    mesh = _make_building(rng, plan.kind, length)
    start = s if sign < 0 else s + length
    d = sign * (plan.back + set_back + (0.0 if plan.kind == "town" else rng.uniform(0, 1.5)))
    site.place(mesh, start, d, KERB_M, facing(sign))
    if plan.kind in ("residential", "avenue") and set_back > 2.5:
        _garden_edge(site, s, length, sign)
        for _ in range(rng.integers(0, 4)):
            bush, along = pick(nursery.bushes, rng), s + rng.uniform(0, length)
            d = sign * (plan.back + rng.uniform(0.8, set_back))
            site.place(bush, along, d, KERB_M)


def _garden_edge(site: Site, s: float, length: float, sign: float) -> None:
    rng = site.rng
    run = length - float(rng.choice([0.0, 2.5]))
    if run < 2:
        return
    draw = rng.random()
    make = next((make for share, make in _EDGES if draw < share), None)
    if make is not None:
        # A hedge is centred, fences begin at their origin.
        start = s + run / 2 if make is plants.make_hedge else s
        site.place(make(run, rng), start, sign * (site.plan.back + 0.2), KERB_M)


def _grove(site: Site, s: float, length: float, sign: float, nursery: _Nursery) -> None:
    rng, plan = site.rng, site.plan
    for _ in range(int(length / 4) + 1):
        tree = nursery.draw_tree(s).scaled(rng.uniform(0.7, 1.25))
        d = sign * (plan.back + rng.uniform(2.5, 22))
        site.place(tree, s + rng.uniform(0, length), d, turned=site.draw_turn())
    for _ in range(int(length / 4)):
        bush = pick(nursery.bushes, rng).scaled(rng.uniform(0.8, 1.8))
        along, d = s + rng.uniform(0, length), sign * (plan.back + rng.uniform(1.2, 8))
        site.place(bush, along, d, turned=site.draw_turn())
    if plan.kind == "highway":
        rail = furniture.make_guard_rail(length)
        turned, start = (0.0, s) if sign > 0 else (np.pi, s + length)
        site.place(rail, start, sign * (plan.kerb + 0.7), turned=turned)
    elif rng.random() < 0.4:
        _garden_edge(site, s, length, sign)


def _side_road(site: Site, c: float, sign: float, nursery: _Nursery) -> None:
    """Make buildings or trees that close the view into a side road."""
    rng, plan = site.rng, site.plan
    make = buildings.make_house if plan.kind == "residential" else buildings.make_town_house
    for edge in (-1.0, 1.0):
        d = plan.back + 16.0
        while d < 75:
            length = rng.uniform(8, 14)
            base = c + edge * (plan.crossing_half + 3.0)
            if rng.random() < 0.65:
                # The front looks at the side road: its normal points to -edge along s.
                start, turned = (d, np.pi / 2) if edge > 0 else (d + length, -np.pi / 2)
                at = sign * (start if sign > 0 else 2 * d + length - start)
                site.place(make(rng, length), base, at, KERB_M, turned)
            else:
                site.place(nursery.draw_tree(base), base + edge * 2, sign * (d + 4))
            d += length


def make_backdrop(site: Site) -> None:
    """Make distant blocks and rows of trees on the horizon."""
    rng, line = site.rng, site.line
    stock = [plants.make_tree(rng, leaf_count=300) for _ in range(2)]
    for _ in range(int(rng.integers(6, 26))):
        angle, reach = rng.uniform(-0.9, 0.9), rng.uniform(170, 380)
        at = np.array([reach * np.cos(angle), reach * np.sin(angle), -2.0])
        s = np.interp(at[0], line.x, line.s)
        if abs(at[1] - np.interp(s, line.s, line.y)) < 35:
            continue
        if rng.random() < 0.35:
            block = buildings.make_office(rng, rng.uniform(15, 40))
            site.meshes.append(block.moved(heading=rng.uniform(0, 6.3), offset=at))
        else:
            for _ in range(5):
                tree = pick(stock, rng).scaled(rng.uniform(1, 1.8))
                site.meshes.append(tree.moved(offset=at + rng.normal(0, 8, 3) * (1, 1, 0)))
