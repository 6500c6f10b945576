"""Objects at the kerb: lamps, signs, lights, clutter and parked cars."""

import numpy as np

from training.scenes.layout.site import KERB_M, START_M, Site, facing
from training.scenes.names import SceneClass
from training.scenes.things import furniture, people, vehicles


def make_furniture(site: Site) -> None:
    """Make lamps, signs, lights, bollards and other things near the kerbs."""
    rng, plan = site.rng, site.plan
    up = KERB_M if plan.pavement else 0.0
    near = plan.kerb + 0.5
    lamp_gap, lamp_height = rng.uniform(18, 35), rng.uniform(5.5, 9)
    for k, s in enumerate(np.arange(-10, 260, lamp_gap) + rng.uniform(0, 9)):
        sign = -1.0 if k % 2 else 1.0
        if plan.free(s, 1):
            lamp = furniture.make_lamp(rng, lamp_height)
            site.place(lamp, s, sign * near, up, facing(sign))
    for s in np.cumsum(rng.uniform(7, 26, 14)):
        sign = -plan.side if rng.random() < 0.65 else plan.side
        if plan.free(s, 0.5):
            toward = 0.0 if sign == -plan.side or rng.random() < 0.5 else np.pi
            mesh = furniture.make_sign(rng)
            turned = toward + rng.normal(0, 0.12)
            site.place(mesh, s, sign * (near + 0.1), up, turned)
    for c in plan.crossings:
        if rng.random() < 0.55:
            phase = int(rng.integers(3))
            gap = plan.crossing_half + 1.5
            for sign in (-1.0, 1.0):
                for way, turned in ((-gap, 0.0), (gap, np.pi)):
                    light = furniture.make_traffic_light(rng, phase)
                    site.place(light, c + way, sign * near, up, turned)
        else:
            mesh = furniture.make_sign(rng, int(rng.choice([4, 7, 1])))
            site.place(mesh, c - plan.crossing_half - 2, -plan.side * near, up)
    if plan.pavement:
        for _ in range(rng.integers(3, 10)):
            _clutter(site, near, up)
    if rng.random() < 0.3:
        wooden = furniture.make_utility_pole(rng)
        sign = float(rng.choice([-1, 1]))
        for s in np.arange(0, 240, 32.0) + rng.uniform(0, 20):
            if plan.free(s, 2):
                site.place(wooden, s, sign * (plan.back + 0.4), up)


def _clutter(site: Site, near: float, up: float) -> None:
    rng, plan = site.rng, site.plan
    sign, s = float(rng.choice([-1, 1])), rng.uniform(3, 110)
    if not plan.free(s, 7):
        return
    draw, turns = rng.random(), [facing(sign)]
    apart = 0.0  # distance between several in a row
    if draw < 0.3:
        mesh, d, apart = furniture.make_bollard(rng), near, 1.5
        turns = [0.0] * int(rng.integers(2, 8))
    elif draw < 0.5:
        mesh, d, turns = furniture.make_bin(rng), near + 0.4, [rng.uniform(0, 6)]
    elif draw < 0.6:
        mesh, d = furniture.make_bench(), plan.back - 0.5
    elif draw < 0.7:
        mesh, d = furniture.make_shelter(rng), near + 1.2
    elif draw < 0.9:
        run = rng.uniform(6, 18)
        if not all(plan.free(x, 1) for x in np.arange(s, s + run, 1.0)):
            return
        mesh, d, turns = furniture.make_railing(run, rng), near - 0.15, [0.0]
    else:
        mesh = people.make_bicycle(SceneClass.MISC, (0.1, 0.1, 0.12))
        d, apart = plan.back - 0.6, 1.0
        turns = rng.normal(1.5, 0.2, rng.integers(1, 4)).tolist()
    for k, turned in enumerate(turns):
        if plan.free(s + apart * k, 1):
            site.place(mesh, s + apart * k, sign * d, up, turned)


def park_cars(site: Site) -> None:
    """Make cars along the kerbs."""
    rng, plan = site.rng, site.plan
    if plan.parking < 2 and plan.kind != "residential":
        return
    for sign in (-1.0, 1.0):
        density, s = float(rng.choice([0.15, 0.5, 0.8])), START_M + rng.uniform(0, 6)
        while s < 210:
            if rng.random() < density and plan.free(s + 2.5, 6):
                mesh = vehicles.make_van(rng) if rng.random() < 0.12 else vehicles.make_car(rng)
                d = sign * (plan.kerb - 1.05 + rng.normal(0, 0.06))
                ahead = sign == -plan.side or rng.random() < 0.1
                turned = (0.0 if ahead else np.pi) + rng.normal(0, 0.015)
                site.place(mesh, s + 2.5, d, turned=turned)
            s += rng.uniform(5.6, 6.8)
