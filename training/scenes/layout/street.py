"""A street: static meshes, moving actors, road paint, and the path of the ego car."""

from dataclasses import dataclass

import numpy as np

from training.scenes.layout.frontage import make_backdrop, make_frontage
from training.scenes.layout.furnishing import make_furniture, park_cars
from training.scenes.layout.ground import draw_stripes, make_ground
from training.scenes.layout.site import Centreline, Site, draw_centreline, draw_plan
from training.scenes.layout.traffic import Actor, draw_people, draw_traffic
from training.scenes.names import StreetKind
from training.scenes.textures.patterns import Stripe
from training.scenes.things.mesh import Mesh, join


@dataclass(frozen=True)
class Street:
    """A street at time 0: static meshes, moving actors, road paint, and the ego car's path."""

    line: Centreline
    standing: Mesh
    actors: tuple[Actor, ...]
    stripes: tuple[Stripe, ...]
    ego_d: float
    ego_speed: float


def build_street(seed: int, *, kind: StreetKind | None = None) -> Street:
    """Lay out a street; the same seed gives the same street.

    Every fifth seed has traffic on the left. If the kind is not given, the seed chooses it.
    """
    rng = np.random.default_rng([seed, 1])
    drawn = list(StreetKind)[rng.choice(5, p=[0.36, 0.22, 0.18, 0.1, 0.14])]
    rng.random()  # not used, but all later numbers, and so the scenes of all seeds, depend on it
    kind = drawn if kind is None else kind
    side = -1.0 if seed % 5 == 0 else 1.0
    bend = float(rng.choice([0.0, 0.3, 1.0]) if kind != "highway" else rng.uniform(0, 1))
    line = draw_centreline(rng, bend)
    plan = draw_plan(rng, kind, side)
    site = Site(rng, plan, line)
    steps = (make_ground, make_frontage, make_furniture, park_cars, make_backdrop)
    for make in steps:
        make(site)
    queue = rng.random() < 0.3
    ego_lane = int(rng.integers(plan.lanes))
    ego_speed = rng.uniform(2, 5) if queue else rng.uniform(6, 13)
    actors = draw_traffic(rng, plan, queue=queue, ego_lane=ego_lane, ego_speed=ego_speed)
    actors += draw_people(rng, plan)
    stripes, ego_d = tuple(draw_stripes(rng, plan)), plan.lane_centre(ego_lane)
    return Street(line, join(*site.meshes), tuple(actors), stripes, ego_d, ego_speed)
