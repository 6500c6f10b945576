"""Moving actors: vehicles, cyclists and pedestrians."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.random import Generator

from training.scenes.layout.site import KERB_M, Centreline, Plan
from training.scenes.things import people, vehicles
from training.scenes.things.mesh import Mesh


@dataclass(frozen=True)
class Actor:
    """A moving object: its mesh by the phase of its motion, and its position by time.

    Attributes:
        pose: returns the mesh for a phase of the motion.
        s, d: street coordinates [m] at time 0.
        speed: speed along s [m/s].
        across: speed along d [m/s].
        up: height above the road [m].
        turned: heading relative to the street [rad].
        cycle: seconds of one step or pedal turn; 0 for rigid things.
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


def _draw_vehicle(rng: Generator, heavy: float) -> tuple[Callable[[float], Mesh], float]:
    """Return a vehicle's rigid pose and length [m]; `heavy`: probability of a lorry or bus."""
    draw = rng.random()
    make = vehicles.make_van if draw < heavy + 0.1 else vehicles.make_car
    if draw < heavy:
        make = vehicles.make_truck if rng.random() < 0.6 else vehicles.make_bus
    mesh = make(rng)
    return lambda _phase: mesh, float(np.ptp(mesh.texture[..., 0]))


def draw_traffic(
    rng: Generator, plan: Plan, *, queue: bool, ego_lane: int, ego_speed: float
) -> list[Actor]:
    """Draw the vehicles of all lanes, and those that wait in side roads."""
    actors = []
    heavy = 0.2 if plan.kind == "highway" else 0.09

    def fill_lane(s: float, end: float, d: float, speed: float, gap: tuple[float, float]) -> None:
        while s < end:
            pose, length = _draw_vehicle(rng, heavy if s > 14 or speed < 0 else 0.02)
            beside = d + rng.normal(0, 0.15)
            actors.append(Actor(pose, s + length / 2, beside, speed, 0.0 if speed > 0 else np.pi))
            s += length + rng.uniform(*gap)

    for lane in range(plan.lanes):
        # In the own direction, everything in the ego lane keeps the ego car's pace.
        speed = ego_speed if lane == ego_lane else ego_speed * rng.uniform(0.6, 1.2)
        s = rng.uniform(8, 14) if queue else rng.uniform(12, 45)
        if lane != ego_lane:
            s = rng.uniform(-6, 16)
        fill_lane(s, 200, plan.lane_centre(lane), speed, (2.5, 7) if queue else (12, 70))
        speed, s, busy = rng.uniform(5, 12), rng.uniform(2, 30), rng.random() < 0.4
        fill_lane(s, 230, -plan.lane_centre(lane), -speed, (4, 14) if busy else (15, 80))
    for c in plan.crossings:
        for sign in (-1.0, 1.0):
            if rng.random() < 0.5:
                pose, length = _draw_vehicle(rng, 0.05)
                # It waits at the mouth of the side road, in its own lane.
                lane_s = c + sign * plan.side * plan.crossing_half / 2
                d = sign * (plan.back + length / 2 + rng.uniform(0, 6))
                actors.append(Actor(pose, lane_s, d, 0.0, -sign * np.pi / 2))
    return actors


def draw_people(rng: Generator, plan: Plan) -> list[Actor]:
    """Draw the groups on the pavements, the people who cross side roads, and the cyclists."""
    actors = []
    most = {"town": 16, "residential": 6, "avenue": 7, "highway": 1, "square": 14}[plan.kind]
    count = int(rng.integers(0, most + 1)) + (2 if plan.kind in ("town", "square") else 0)
    for _ in range(count if plan.pavement else 0):
        sign = float(rng.choice([-1, 1]))
        d = sign * (plan.back - rng.uniform(0.4, max(0.5, plan.pavement - 0.5)))
        s = rng.uniform(4, 75)
        group = int(rng.choice([1, 1, 1, 2, 2, 3]))
        speed = float(rng.choice([-1, 1])) * rng.uniform(1.0, 1.6)
        pace = 0.0 if rng.random() < 0.2 else speed
        for k in range(group):
            along, beside = s + 0.3 * float(rng.normal()), d + 0.65 * k * -sign
            actors.append(_walker(rng, along, beside, pace, 0.0, KERB_M))
    for c in plan.crossings[:2]:
        for _ in range(rng.integers(0, 3)):
            across, d = float(rng.choice([-1.3, 1.3])), rng.uniform(-plan.kerb, plan.kerb)
            s = c - plan.crossing_half - 3.4 + rng.normal(0, 0.6)
            if s > 9:
                actors.append(_walker(rng, s, d, 0.0, across, 0.0))
    for _ in range(int(rng.integers(0, 4)) if plan.kind != "highway" else 0):
        way = 1 if rng.random() < 0.6 else -1
        d = -plan.side * way * (plan.lane * plan.lanes - 0.45)
        pose = partial(people.make_cyclist, people.draw_dress(rng, cyclist=True))
        speed, s = rng.uniform(3.5, 6) * way, rng.uniform(7, 50)
        actors.append(Actor(pose, s, d, speed, 0.0 if way > 0 else np.pi, cycle=1.1))
    return actors


def _walker(rng: Generator, s: float, d: float, speed: float, across: float, up: float) -> Actor:
    dress, still = people.draw_dress(rng), speed == 0 and across == 0
    turned = rng.uniform(0, 6.3) if still else float(np.arctan2(across, speed))
    pose = partial(people.make_walker, dress, standing=still)
    return Actor(pose, s, d, speed, turned, across=across, up=up, cycle=1.05)
