"""Layout of a street: what stands where, what moves, and what is painted on the road."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.random import Generator

from training.scenes import buildings, furniture, people, plants, vehicles
from training.scenes.arrays import Floats
from training.scenes.centreline import Centreline, draw_centreline
from training.scenes.classes import SceneClass
from training.scenes.mesh import Look, Mesh, grid, join
from training.scenes.paint import Stripe
from training.scenes.surface_kinds import SurfaceKind

StreetKind = Literal["town", "residential", "avenue", "highway", "square"]
STREET_KINDS: tuple[StreetKind, ...] = ("town", "residential", "avenue", "highway", "square")

_KERB = 0.12
_START, _END = -40.0, 330.0


@dataclass(frozen=True)
class Actor:
    """Something that moves along the street: its mesh at a phase, and where it is when.

    s, d: street coordinates [m] at time 0. speed: m/s along s. across: m/s along d. turned: heading
    relative to the street [rad]. cycle: seconds of one step or pedal turn, 0 for rigid things.
    """

    pose: Callable[[float], Mesh]
    s: float
    d: float
    speed: float
    turned: float
    across: float = 0.0
    up: float = 0.0
    cycle: float = 0.0

    def at(self, time: float, line: Centreline) -> Mesh:
        """The mesh in the world at a time in seconds."""
        s, d = self.s + self.speed * time, self.d + self.across * time
        phase = (time / self.cycle + self.s) % 1.0 if self.cycle else 0.0
        heading = float(line.heading_at(s)) + self.turned
        return self.pose(phase).moved(heading=heading, offset=line.at(s, d, self.up))


@dataclass(frozen=True)
class Street:
    """A street at time 0: what stands, what moves, what is painted, and how the ego car drives."""

    kind: StreetKind
    line: Centreline
    standing: Mesh
    actors: tuple[Actor, ...]
    stripes: tuple[Stripe, ...]
    ego_d: float
    ego_speed: float


@dataclass(frozen=True)
class Plan:
    """Cross-section of the street; everything in metres from the centre line.

    side: +1 traffic keeps right, -1 keeps left. Own lanes lie at -side * d.
    """

    kind: StreetKind
    side: float
    lane: float
    lanes: int
    parking: float
    verge: float
    pavement: float
    crossings: tuple[float, ...]
    crossing_half: float

    @property
    def kerb(self) -> float:
        """Distance of the kerbs from the centre line."""
        return self.lane * self.lanes + self.parking

    @property
    def back(self) -> float:
        """Distance of the plots behind the pavement."""
        return self.kerb + self.verge + self.pavement

    def free(self, s: float, margin: float = 0.0) -> bool:
        """Whether s is clear of every side road."""
        return all(abs(s - c) > self.crossing_half + margin for c in self.crossings)


def _draw_plan(rng: Generator, kind: StreetKind, side: float) -> Plan:
    lanes = {
        "town": 1,
        "residential": 1,
        "avenue": int(rng.integers(1, 3)),
        "highway": int(rng.integers(1, 3)),
        "square": int(rng.integers(1, 4)),
    }[kind]
    lane = float(rng.uniform(3.0, 3.7))
    parking = (
        2.2
        if kind in ("town", "residential") and rng.random() < 0.7
        else (0.5 if kind != "highway" else 1.5)
    )
    verge = {
        "town": 0.0,
        "residential": float(rng.choice([0.0, 1.5])),
        "avenue": float(rng.uniform(1.5, 4)),
        "highway": 0.0,
        "square": 0.0,
    }[kind]
    pavement = 0.0 if kind == "highway" and rng.random() < 0.6 else float(rng.uniform(1.8, 4.5))
    crossings: list[float] = []
    where = float(rng.uniform(12, 70))
    while where < 260 and kind != "highway":
        crossings.append(where)
        where += float(rng.uniform(45, 120))
    if kind == "highway" and rng.random() < 0.3:
        crossings = [float(rng.uniform(40, 90))]
    return Plan(
        kind,
        side,
        lane,
        lanes,
        parking,
        verge,
        pavement,
        tuple(crossings),
        float(rng.uniform(3.2, 5.5)),
    )


def build_street(
    seed: int, *, kind: StreetKind | None = None, left_hand: bool | None = None
) -> Street:
    """Lay out a street; the same seed gives the same street.

    kind and left_hand are drawn from the seed unless given.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
    drawn: StreetKind = STREET_KINDS[rng.choice(5, p=[0.36, 0.22, 0.18, 0.1, 0.14])]
    drawn_left = bool(rng.random() < 0.4)
    kind = drawn if kind is None else kind
    side = -1.0 if (drawn_left if left_hand is None else left_hand) else 1.0
    bend = float(rng.choice([0.0, 0.3, 1.0]) if kind != "highway" else rng.uniform(0, 1))
    line = draw_centreline(rng, start=_START - 30, end=_END + 120, bend=bend)
    plan = _draw_plan(rng, kind, side)
    parts = _ground(rng, plan, line)
    parts += _frontage(rng, plan, line)
    parts += _furnish(rng, plan, line)
    parts += _parked(rng, plan, line)
    parts += _backdrop(rng, line)
    queue = bool(rng.random() < 0.3)
    ego_lane = int(rng.integers(plan.lanes))
    ego_speed = float(rng.uniform(2, 5)) if queue else float(rng.uniform(6, 13))
    actors = _traffic(rng, plan, queue=queue, ego_lane=ego_lane, ego_speed=ego_speed)
    actors += _people(rng, plan)
    return Street(
        kind,
        line,
        join(parts),
        tuple(actors),
        tuple(_stripes(rng, plan)),
        _lane_d(plan, ego_lane),
        ego_speed,
    )


def _lane_d(plan: Plan, lane: int, *, own: bool = True) -> float:
    """Centre of an own or oncoming lane; lane 0 is next to the centre line."""
    d = -plan.side * plan.lane * (lane + 0.5)
    return d if own else -d


# ---- ground ------------------------------------------------------------------------------------


def _ribbon(line: Centreline, s: Floats, edges: list[tuple[float, float]], look: Look) -> Mesh:
    """A strip along the street through points (d, up), listed from right to left."""
    d, up = np.array(edges).T
    points = line.at(s[:, None], d[None], up[None])
    texture = np.stack(np.broadcast_arrays(s[:, None], d[None], up[None]), axis=-1)
    return grid(points, look, texture=texture)


def _ground(rng: Generator, plan: Plan, line: Centreline) -> list[Mesh]:
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
    whole = np.arange(_START, _END + 60, 3.0)
    parts = [
        _ribbon(line, whole, [(-plan.kerb, 0.0), (plan.kerb, 0.0)], asphalt),
        _ribbon(
            line,
            np.array([_START - 20, *np.linspace(0, _END, 40), _END + 110]),
            [(-420.0, -2.0), (-80.0, -0.25), (80.0, -0.25), (420.0, -2.0)],
            grass,
        ),
    ]
    stops = [
        _START,
        *sum(((c - plan.crossing_half, c + plan.crossing_half) for c in plan.crossings), ()),
        _END + 60,
    ]
    for a, b in zip(stops[::2], stops[1::2], strict=True):
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
            parts.append(strip([(k, -0.05), (k, _KERB), (inner, _KERB)], kerb))
            if plan.verge:
                parts.append(strip([(inner, _KERB), (inner + plan.verge, _KERB)], grass))
            parts.append(strip([(inner + plan.verge, _KERB), (p, _KERB)], paving))
            behind = fore if plan.kind in ("town", "square") else grass
            parts.append(strip([(p, _KERB), (p + 8, _KERB), (60, _KERB - 0.05)], behind))
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


def _stripes(rng: Generator, plan: Plan) -> list[Stripe]:
    """Centre and lane lines, edge lines, stop lines, zebra crossings."""
    stripes = []
    stops = [
        _START,
        *sum(
            ((c - plan.crossing_half - 2.5, c + plan.crossing_half + 2.5) for c in plan.crossings),
            (),
        ),
        _END,
    ]
    yellow = (0.55, 0.38, 0.04)
    center_solid = rng.random() < 0.25
    edge_line = plan.kind in ("highway", "avenue") or rng.random() < 0.3
    double_yellow = plan.side < 0 and plan.parking < 1 and rng.random() < 0.6
    wide = float(rng.uniform(0.05, 0.08))
    dash, share = float(rng.choice([6.0, 9.0, 12.0])), float(rng.choice([0.33, 0.5]))
    centre = plan.kind != "residential" or rng.random() < 0.4
    for a, b in zip(stops[::2], stops[1::2], strict=True):
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
            stripes.append(
                Stripe(
                    "s",
                    rim,
                    0.12,
                    c - plan.crossing_half + 0.2,
                    c + plan.crossing_half - 0.2,
                    0.8,
                    0.6,
                )
            )
    if plan.lanes > 1:
        for lane in range(plan.lanes):
            where = float(rng.uniform(8, 40))
            d = _lane_d(plan, lane)
            stripes.append(Stripe("s", d, 0.09, where, where + 3.2))
            stripes += [
                Stripe("s", d, 0.42 - 0.42 * k / 7, where + 3.2 + 0.24 * k, where + 3.44 + 0.24 * k)
                for k in range(7)
            ]
    return stripes


# ---- what stands -------------------------------------------------------------------------------


def _place(line: Centreline, mesh: Mesh, s: float, d: float, up: float, turned: float) -> Mesh:
    heading = float(line.heading_at(s)) + turned
    return mesh.moved(heading=heading, offset=line.at(s, d, up))


def _facing(sign: float) -> float:
    """Turn that makes a thing with its front on +y face the road from side `sign`."""
    return np.pi if sign > 0 else 0.0


@dataclass(frozen=True)
class TreeStock:
    """The trees a street is planted with: detailed ones near its start, coarse ones far off."""

    near: tuple[Mesh, ...]
    far: tuple[Mesh, ...]

    def draw(self, rng: Generator, s: float) -> Mesh:
        """A tree for the place s along the street."""
        trees = self.near if s < 75 else self.far
        return trees[rng.integers(len(trees))]


def _draw_stock(rng: Generator) -> TreeStock:
    bare = (plants.make_bare_tree(rng), plants.make_bare_tree(rng)) if rng.random() < 0.35 else ()
    near = (*(plants.make_tree(rng) for _ in range(4)), plants.make_conifer(rng), *bare)
    far = (
        *(plants.make_tree(rng, leaf_count=700) for _ in range(4)),
        plants.make_conifer(rng, leaf_count=500),
        *bare,
    )
    return TreeStock(near, far)


def _frontage(rng: Generator, plan: Plan, line: Centreline) -> list[Mesh]:
    """Buildings, gardens and trees behind the pavement on both sides."""
    parts: list[Mesh] = []
    stock = _draw_stock(rng)
    bushes = [plants.make_bush(rng) for _ in range(3)]
    green = {"town": 0.1, "residential": 0.35, "avenue": 0.55, "highway": 0.85, "square": 0.45}
    for sign in (-1.0, 1.0):
        share = np.clip(green[plan.kind] + rng.normal(0, 0.15), 0, 1)
        set_back = {
            "town": 0.0,
            "residential": float(rng.uniform(3, 7)),
            "avenue": float(rng.uniform(2, 10)),
            "highway": 14.0,
            "square": float(rng.uniform(4, 15)),
        }[plan.kind]
        s = _START + float(rng.uniform(0, 8))
        while s < _END:
            length = float(
                rng.uniform(6, 16) if plan.kind in ("town", "residential") else rng.uniform(12, 34)
            )
            blocked = [
                c
                for c in plan.crossings
                if s < c + plan.crossing_half + 2.5 and s + length > c - plan.crossing_half - 2.5
            ]
            if blocked:
                room = blocked[0] - plan.crossing_half - 2.5 - s
                if room < 5:
                    s = blocked[0] + plan.crossing_half + 2.5
                    continue
                length = room
            if rng.random() < share:
                parts += _grove(rng, plan, line, s, length, sign, stock, bushes)
            else:
                parts += _plot(rng, plan, line, s, length, sign, set_back, bushes)
            s += length + (0.02 if plan.kind == "town" else float(rng.uniform(0.5, 5)))
        for c in plan.crossings:
            parts += _side_road(rng, plan, line, c, sign, stock)
    if plan.verge or plan.kind in ("square", "avenue") or rng.random() < 0.25:
        spacing = float(rng.uniform(8, 18))
        d = plan.kerb + (plan.verge / 2 if plan.verge else 0.9)
        for sign in (-1.0, 1.0):
            for s in np.arange(_START, 220, spacing) + rng.uniform(0, 6):
                if plan.free(s, 3) and rng.random() < 0.75:
                    tree = stock.draw(rng, s).scaled(float(rng.uniform(0.6, 0.9)))
                    parts.append(_place(line, tree, s, sign * d, _KERB, float(rng.uniform(0, 6.3))))
    return parts


def _plot(
    rng: Generator,
    plan: Plan,
    line: Centreline,
    s: float,
    length: float,
    sign: float,
    set_back: float,
    bushes: list[Mesh],
) -> list[Mesh]:
    kind = plan.kind
    if kind == "town":
        shop = bool(rng.random() < 0.55)
        mesh = (
            buildings.make_office(rng, length)
            if length > 11 and rng.random() < 0.3
            else buildings.make_town_house(rng, length, shop=shop)
        )
    elif kind == "residential":
        mesh = (
            buildings.make_house(rng, length)
            if rng.random() < 0.75
            else buildings.make_town_house(rng, length, shop=False)
        )
    else:
        draw = rng.random()
        mesh = (
            buildings.make_office(rng, length)
            if draw < 0.5
            else buildings.make_town_house(rng, length, shop=True)
            if draw < 0.75
            else buildings.make_shed(rng, length)
        )
    turned = _facing(sign)
    start = s if sign < 0 else s + length
    d = sign * (plan.back + set_back + (0.0 if kind == "town" else rng.uniform(0, 1.5)))
    parts = [_place(line, mesh, start, d, _KERB, turned)]
    if kind in ("residential", "avenue") and set_back > 2.5:
        parts += _garden_edge(rng, plan, line, s, length, sign)
        for _ in range(rng.integers(0, 4)):
            parts.append(
                _place(
                    line,
                    bushes[rng.integers(len(bushes))],
                    s + rng.uniform(0, length),
                    sign * (plan.back + rng.uniform(0.8, set_back)),
                    _KERB,
                    0.0,
                )
            )
    return parts


def _garden_edge(
    rng: Generator, plan: Plan, line: Centreline, s: float, length: float, sign: float
) -> list[Mesh]:
    run = max(1.0, length - float(rng.choice([0.0, 2.5])))
    if run < 2:
        return []
    d = sign * (plan.back + 0.2)
    draw = rng.random()
    if draw < 0.3:
        hedge = plants.make_hedge(run, float(rng.uniform(0.9, 1.9)), rng)
        return [_place(line, hedge, s + run / 2, d, _KERB, 0.0)]
    if draw < 0.55:
        fence = furniture.make_board_fence(run, float(rng.uniform(0.9, 1.9)), rng)
    elif draw < 0.75:
        fence = furniture.make_wall(run, float(rng.uniform(0.5, 1.6)), rng)
    elif draw < 0.9:
        fence = furniture.make_railing(run, rng)
    else:
        return []
    return [_place(line, fence, s, d, _KERB, 0.0)]


def _grove(
    rng: Generator,
    plan: Plan,
    line: Centreline,
    s: float,
    length: float,
    sign: float,
    stock: TreeStock,
    bushes: list[Mesh],
) -> list[Mesh]:
    parts = []
    for _ in range(int(length / 4) + 1):
        tree = stock.draw(rng, s).scaled(float(rng.uniform(0.7, 1.25)))
        d = sign * (plan.back + rng.uniform(2.5, 22))
        parts.append(
            _place(line, tree, s + rng.uniform(0, length), d, 0.0, float(rng.uniform(0, 6.3)))
        )
    for _ in range(int(length / 4)):
        bush = bushes[rng.integers(len(bushes))].scaled(float(rng.uniform(0.8, 1.8)))
        parts.append(
            _place(
                line,
                bush,
                s + rng.uniform(0, length),
                sign * (plan.back + rng.uniform(1.2, 8)),
                0.0,
                float(rng.uniform(0, 6.3)),
            )
        )
    if plan.kind == "highway":
        rail = furniture.make_guard_rail(length)
        up, turned, start = 0.0, 0.0 if sign > 0 else np.pi, s if sign > 0 else s + length
        parts.append(_place(line, rail, start, sign * (plan.kerb + 0.7), up, turned))
    elif rng.random() < 0.4:
        parts += _garden_edge(rng, plan, line, s, length, sign)
    return parts


def _side_road(
    rng: Generator, plan: Plan, line: Centreline, c: float, sign: float, stock: TreeStock
) -> list[Mesh]:
    """Buildings or trees that close the view into a side road."""
    parts = []
    for edge in (-1.0, 1.0):
        d = plan.back + 16.0
        while d < 75:
            length = float(rng.uniform(8, 14))
            base = c + edge * (plan.crossing_half + 3.0)
            if rng.random() < 0.65:
                house = (
                    buildings.make_house(rng, length)
                    if plan.kind == "residential"
                    else buildings.make_town_house(rng, length, shop=False)
                )
                # The front looks at the side road: its normal points to -edge along s.
                turned = -edge * np.pi / 2 + np.pi
                start = d if edge > 0 else d + length
                turned = np.pi / 2 if edge > 0 else -np.pi / 2
                at = sign * (start if sign > 0 else 2 * d + length - start)
                parts.append(_place(line, house, base, at, _KERB, turned))
            else:
                tree = stock.draw(rng, base)
                parts.append(_place(line, tree, base + edge * 2, sign * (d + 4), 0.0, 0.0))
            d += length
    return parts


def _furnish(rng: Generator, plan: Plan, line: Centreline) -> list[Mesh]:
    """Lamps, signs, lights, bollards and the rest, near the kerbs."""
    parts: list[Mesh] = []
    up = _KERB if plan.pavement else 0.0
    near = plan.kerb + 0.5
    lamp_gap, lamp_height = float(rng.uniform(18, 35)), float(rng.uniform(5.5, 9))
    for k, s in enumerate(np.arange(-10, 260, lamp_gap) + rng.uniform(0, 9)):
        sign = -1.0 if k % 2 else 1.0
        if plan.free(s, 1):
            lamp = furniture.make_lamp(rng, lamp_height)
            parts.append(_place(line, lamp, s, sign * near, up, _facing(sign)))
    for s in np.cumsum(rng.uniform(7, 26, 14)):
        sign = -1.0 if rng.random() < 0.65 else 1.0
        sign *= plan.side
        if plan.free(s, 0.5):
            toward = 0.0 if sign == -plan.side or rng.random() < 0.5 else np.pi
            sign_mesh = furniture.make_sign(rng)
            parts.append(
                _place(
                    line, sign_mesh, s, sign * (near + 0.1), up, toward + float(rng.normal(0, 0.12))
                )
            )
    for c in plan.crossings:
        if rng.random() < 0.55:
            phase = int(rng.integers(3))
            for sign in (-1.0, 1.0):
                gap = plan.crossing_half + 1.5
                light = furniture.make_traffic_light(rng, phase)
                parts.append(_place(line, light, c - gap, sign * near, up, 0.0))
                back = furniture.make_traffic_light(rng, phase)
                parts.append(_place(line, back, c + gap, sign * near, up, np.pi))
        else:
            parts.append(
                _place(
                    line,
                    furniture.make_sign(rng, int(rng.choice([4, 7, 1]))),
                    c - plan.crossing_half - 2,
                    -plan.side * near,
                    up,
                    0.0,
                )
            )
    if plan.pavement:
        for _ in range(rng.integers(3, 10)):
            parts += _clutter(rng, plan, line, near, up)
    if rng.random() < 0.3:
        wooden = furniture.make_utility_pole(rng)
        sign = float(rng.choice([-1, 1]))
        parts += [
            _place(line, wooden, s, sign * (plan.back + 0.4), up, 0.0)
            for s in np.arange(0, 240, 32.0) + rng.uniform(0, 20)
            if plan.free(s, 2)
        ]
    return parts


def _clutter(rng: Generator, plan: Plan, line: Centreline, near: float, up: float) -> list[Mesh]:
    sign = float(rng.choice([-1, 1]))
    s = float(rng.uniform(3, 110))
    if not plan.free(s, 7):
        return []
    draw = rng.random()
    if draw < 0.3:
        bollard = furniture.make_bollard(rng)
        return [
            _place(line, bollard, s + 1.5 * k, sign * near, up, 0.0)
            for k in range(rng.integers(2, 8))
            if plan.free(s + 1.5 * k, 1)
        ]
    if draw < 0.5:
        bin_ = furniture.make_bin(rng)
        return [_place(line, bin_, s, sign * (near + 0.4), up, float(rng.uniform(0, 6)))]
    if draw < 0.6:
        return [
            _place(line, furniture.make_bench(), s, sign * (plan.back - 0.5), up, _facing(sign))
        ]
    if draw < 0.7:
        return [
            _place(line, furniture.make_shelter(rng), s, sign * (near + 1.2), up, _facing(sign))
        ]
    if draw < 0.9:
        run = float(rng.uniform(6, 18))
        if not all(plan.free(x, 1) for x in np.arange(s, s + run, 1.0)):
            return []
        return [_place(line, furniture.make_railing(run, rng), s, sign * (near - 0.15), up, 0.0)]
    bike = people.make_bicycle(SceneClass.MISC, (0.1, 0.1, 0.12))
    return [
        _place(line, bike, s + k, sign * (plan.back - 0.6), up, float(rng.normal(1.5, 0.2)))
        for k in range(rng.integers(1, 4))
    ]


def _parked(rng: Generator, plan: Plan, line: Centreline) -> list[Mesh]:
    """Cars along the kerbs and, in some streets, on the pavement side or in bays."""
    parts: list[Mesh] = []
    if plan.parking < 2 and plan.kind != "residential":
        return parts
    for sign in (-1.0, 1.0):
        density = float(rng.choice([0.15, 0.5, 0.8]))
        s = _START + float(rng.uniform(0, 6))
        while s < 210:
            if rng.random() < density and plan.free(s + 2.5, 6):
                mesh = vehicles.make_van(rng) if rng.random() < 0.12 else vehicles.make_car(rng)
                d = sign * (plan.kerb - 1.05 + float(rng.normal(0, 0.06)))
                ahead = sign == -plan.side or rng.random() < 0.1
                turned = (0.0 if ahead else np.pi) + float(rng.normal(0, 0.015))
                parts.append(_place(line, mesh, s + 2.5, d, 0.0, turned))
            s += float(rng.uniform(5.6, 6.8))
    return parts


def _backdrop(rng: Generator, line: Centreline) -> list[Mesh]:
    """Distant blocks and rows of trees on the horizon."""
    parts = []
    stock = [plants.make_tree(rng, leaf_count=300) for _ in range(2)]
    for _ in range(int(rng.integers(6, 26))):
        angle, reach = rng.uniform(-0.9, 0.9), rng.uniform(170, 380)
        at = np.array([reach * np.cos(angle), reach * np.sin(angle), -2.0])
        s = np.interp(at[0], line.x, line.s)
        if abs(at[1] - np.interp(s, line.s, line.y)) < 35:
            continue
        if rng.random() < 0.35:
            block = buildings.make_office(rng, float(rng.uniform(15, 40)))
            parts.append(block.moved(heading=float(rng.uniform(0, 6.3)), offset=at))
        else:
            for _ in range(5):
                tree = stock[rng.integers(2)].scaled(float(rng.uniform(1, 1.8)))
                parts.append(tree.moved(offset=at + rng.normal(0, 8, 3) * (1, 1, 0)))
    return parts


# ---- what moves --------------------------------------------------------------------------------


def _vehicle(rng: Generator, *, heavy: float) -> tuple[Mesh, float]:
    draw = rng.random()
    if draw < heavy:
        mesh = vehicles.make_truck(rng) if rng.random() < 0.6 else vehicles.make_bus(rng)
    elif draw < heavy + 0.1:
        mesh = vehicles.make_van(rng)
    else:
        mesh = vehicles.make_car(rng)
    return mesh, vehicles.car_length(mesh)


def _rigid(mesh: Mesh) -> Callable[[float], Mesh]:
    return lambda _phase: mesh


def _traffic(
    rng: Generator, plan: Plan, *, queue: bool, ego_lane: int, ego_speed: float
) -> list[Actor]:
    actors = []
    heavy = 0.2 if plan.kind == "highway" else 0.09
    for lane in range(plan.lanes):
        # Own direction: everything in the ego lane keeps the ego car's pace.
        speed = ego_speed if lane == ego_lane else ego_speed * float(rng.uniform(0.6, 1.2))
        s = float(rng.uniform(8, 14) if queue else rng.uniform(12, 45))
        if lane != ego_lane:
            s = float(rng.uniform(-6, 16))
        while s < 200:
            mesh, length = _vehicle(rng, heavy=heavy if s > 14 else 0.02)
            actors.append(
                Actor(
                    _rigid(mesh),
                    s + length / 2,
                    _lane_d(plan, lane) + float(rng.normal(0, 0.15)),
                    speed,
                    0.0,
                )
            )
            s += length + float(rng.uniform(2.5, 7) if queue else rng.uniform(12, 70))
        speed = float(rng.uniform(5, 12))
        s = float(rng.uniform(2, 30))
        busy = rng.random() < 0.4
        while s < 230:
            mesh, length = _vehicle(rng, heavy=heavy)
            actors.append(
                Actor(
                    _rigid(mesh),
                    s + length / 2,
                    _lane_d(plan, lane, own=False) + float(rng.normal(0, 0.15)),
                    -speed,
                    np.pi,
                )
            )
            s += length + float(rng.uniform(4, 14) if busy else rng.uniform(15, 80))
    for c in plan.crossings:
        for sign in (-1.0, 1.0):
            if rng.random() < 0.5:
                mesh, length = _vehicle(rng, heavy=0.05)
                # Waiting at the mouth of the side road, on its own lane.
                lane_s = c + sign * plan.side * plan.crossing_half / 2
                d = sign * (plan.back + length / 2 + float(rng.uniform(0, 6)))
                actors.append(Actor(_rigid(mesh), lane_s, d, 0.0, -sign * np.pi / 2))
    return actors


def _people(rng: Generator, plan: Plan) -> list[Actor]:
    actors = []
    count = {"town": 16, "residential": 6, "avenue": 7, "highway": 1, "square": 14}[plan.kind]
    count = int(rng.integers(0, count + 1)) + (2 if plan.kind in ("town", "square") else 0)
    room = max(plan.pavement, 1.0)
    for _ in range(count if plan.pavement else 0):
        sign = float(rng.choice([-1, 1]))
        d = sign * (plan.back - float(rng.uniform(0.4, max(0.5, room - 0.5))))
        s = float(rng.uniform(4, 75))
        group = int(rng.choice([1, 1, 1, 2, 2, 3]))
        speed = float(rng.choice([-1, 1])) * float(rng.uniform(1.0, 1.6))
        standing = rng.random() < 0.2
        for k in range(group):
            actors.append(
                _walker(
                    rng,
                    s + 0.3 * float(rng.normal()),
                    d + 0.65 * k * -sign,
                    0.0 if standing else speed,
                    0.0,
                    _KERB,
                )
            )
    for c in plan.crossings[:2]:
        for _ in range(rng.integers(0, 3)):
            toward = float(rng.choice([-1, 1]))
            d = float(rng.uniform(-plan.kerb, plan.kerb))
            s = c - plan.crossing_half - 3.4 + float(rng.normal(0, 0.6))
            if s > 9:
                actors.append(_walker(rng, s, d, 0.0, toward * 1.3, 0.0))
    for _ in range(int(rng.integers(0, 4)) if plan.kind != "highway" else 0):
        own = rng.random() < 0.6
        edge = plan.lane * plan.lanes - 0.45
        d = -plan.side * edge if own else plan.side * edge
        dress = people.draw_dress(rng, cyclist=True)
        speed = float(rng.uniform(3.5, 6)) * (1 if own else -1)
        actors.append(
            Actor(
                lambda phase, dress=dress: people.make_cyclist(dress, phase),
                float(rng.uniform(7, 50)),
                d,
                speed,
                0.0 if own else np.pi,
                cycle=1.1,
            )
        )
    return actors


def _walker(rng: Generator, s: float, d: float, speed: float, across: float, up: float) -> Actor:
    dress = people.draw_dress(rng)
    still = speed == 0 and across == 0
    turned = float(rng.uniform(0, 6.3)) if still else float(np.arctan2(across, speed))
    return Actor(
        lambda phase: people.make_walker(dress, phase, standing=still),
        s,
        d,
        speed,
        turned,
        across=across,
        up=up,
        cycle=1.05,
    )
