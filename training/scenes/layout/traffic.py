"""Moving actors: vehicles, cyclists and pedestrians."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.random import Generator

from training.scenes.layout.centreline import Centreline
from training.scenes.layout.street_plan import KERB_M, Plan, lane_centre
from training.scenes.things import people, vehicles
from training.scenes.things.mesh import Mesh


@dataclass(frozen=True)
class Actor:
    """A moving object: its mesh by the phase of its motion, and its position by time.

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


def draw_traffic(
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
            d = lane_centre(plan, lane) + float(rng.normal(0, 0.15))
            actors.append(Actor(_rigid(mesh), s + length / 2, d, speed, 0.0))
            s += length + float(rng.uniform(2.5, 7) if queue else rng.uniform(12, 70))
        speed = float(rng.uniform(5, 12))
        s = float(rng.uniform(2, 30))
        busy = rng.random() < 0.4
        while s < 230:
            mesh, length = _vehicle(rng, heavy=heavy)
            d = lane_centre(plan, lane, own=False) + float(rng.normal(0, 0.15))
            actors.append(Actor(_rigid(mesh), s + length / 2, d, -speed, np.pi))
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


def draw_people(rng: Generator, plan: Plan) -> list[Actor]:
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
            along, beside = s + 0.3 * float(rng.normal()), d + 0.65 * k * -sign
            pace = 0.0 if standing else speed
            actors.append(_walker(rng, along, beside, pace, 0.0, KERB_M))
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
        pose, s = partial(people.make_cyclist, dress), float(rng.uniform(7, 50))
        actors.append(Actor(pose, s, d, speed, 0.0 if own else np.pi, cycle=1.1))
    return actors


def _walker(rng: Generator, s: float, d: float, speed: float, across: float, up: float) -> Actor:
    dress = people.draw_dress(rng)
    still = speed == 0 and across == 0
    turned = float(rng.uniform(0, 6.3)) if still else float(np.arctan2(across, speed))
    pose = partial(people.make_walker, dress, standing=still)
    return Actor(pose, s, d, speed, turned, across=across, up=up, cycle=1.05)
