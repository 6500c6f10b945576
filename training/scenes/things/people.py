"""Pedestrians and cyclists made of tapered limbs, posed by the phase of their step."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.random import Generator

from training.scenes.arrays import Floats
from training.scenes.names import SceneClass
from training.scenes.textures.surface import SurfaceKind
from training.scenes.things.mesh import Color, Look, Mesh, box, ellipsoid, join, pick, rows, tube

_SKIN = rows("0.52 0.33 0.24, 0.4 0.24 0.16, 0.2 0.11 0.07")
_HAIR = rows("0.03 0.02 0.015, 0.1 0.06 0.03, 0.3 0.22 0.1, 0.3 0.3 0.3")
_TOPS = rows(
    "0.02 0.02 0.025, 0.05 0.06 0.12, 0.3 0.03 0.03, 0.5 0.5 0.48, 0.08 0.15 0.06, "
    "0.25 0.2 0.12, 0.12 0.12 0.13, 0.1 0.2 0.4, 0.5 0.35 0.05"
)
_BOTTOMS = rows("0.02 0.02 0.03, 0.04 0.06 0.14, 0.12 0.1 0.07, 0.08 0.08 0.09")


_REFLECTIVE = (0.5, 0.6, 0.02)

# Radii [m] of thigh, shin, upper arm and forearm, each from its upper to its lower end.
_WALKING = np.array(rows("0.095 0.065, 0.064 0.05, 0.062 0.05, 0.048 0.04"))
_RIDING = np.array(rows("0.095 0.065, 0.064 0.048, 0.06 0.05, 0.048 0.04"))


@dataclass(frozen=True)
class Dress:
    """Build of one person, and the colours of skin, hair, top, bottom and shoes."""

    colors: tuple[Color, ...]
    height: float
    breadth: float
    bag: bool
    long_coat: bool
    helmet: bool

    def clothes(self, label: SceneClass) -> tuple[Look, ...]:
        return tuple(Look(SurfaceKind.CLOTH, color, label) for color in self.colors)


def draw_dress(rng: Generator, *, cyclist: bool = False) -> Dress:
    """Draw how a person looks."""
    tops = (*_TOPS, _REFLECTIVE, _REFLECTIVE) if cyclist else _TOPS
    return Dress(
        colors=(*(pick(each, rng) for each in (_SKIN, _HAIR, tops, _BOTTOMS)), (0.03, 0.03, 0.03)),
        height=float(rng.choice([1.25, *rng.uniform(1.55, 1.9, 6)])),
        breadth=rng.uniform(0.9, 1.2),
        bag=rng.random() < 0.35,
        long_coat=rng.random() < 0.3,
        helmet=cyclist and rng.random() < 0.6,
    )


def _limb(joints: Iterable[Floats], radii: Floats, look: Look) -> list[Mesh]:
    """Make a leg or an arm, from the hip or shoulder on."""
    bones = zip(pairwise(joints), radii, strict=True)
    return [tube(*ends, (upper, lower), look, rounded=True) for ends, (upper, lower) in bones]


def make_walker(dress: Dress, phase: float, *, standing: bool = False) -> Mesh:
    """A pedestrian at `phase` (0..1) of the step; x forward, feet on z = 0."""
    skin, hair, top, bottom, shoe = dress.clothes(SceneClass.PEDESTRIAN)
    swing = 0.08 if standing else 0.42 * float(np.sin(2 * np.pi * phase))
    b = dress.breadth
    parts = []
    for sign in (-1.0, 1.0):
        angle = swing * sign
        hip = np.array([0.0, 0.09 * sign * b, 0.92])
        knee = hip + 0.44 * np.array([np.sin(angle), 0, -np.cos(angle)])
        bend = angle - max(0.0, -angle) * 0.9 - 0.05
        ankle = knee + 0.42 * np.array([np.sin(bend), 0, -np.cos(bend)])
        shoulder = np.array([0.0, 0.2 * sign * b, 1.43])
        elbow = shoulder + 0.29 * np.array([-np.sin(angle), 0.12 * sign, -np.cos(angle)])
        hand = elbow + 0.26 * np.array([np.sin(0.35 - angle), 0, -np.cos(0.35 - angle)])
        parts += _limb((hip, knee, ankle), _WALKING[:2] * b, bottom)
        parts.append(ellipsoid(np.add(ankle, (0.07, 0, -0.03)), (0.14, 0.05, 0.055), shoe))
        parts += _limb((shoulder, elbow, hand), _WALKING[2:] * b, top)
        parts.append(ellipsoid(hand, (0.05, 0.035, 0.06), skin))
    parts.append(ellipsoid((0, 0, 1.22), (0.13 * b, 0.19 * b, 0.33), top))
    parts.append(ellipsoid((0, 0, 1.38), (0.12 * b, 0.22 * b, 0.15), top))
    parts.append(ellipsoid((0, 0, 0.95), (0.125 * b, 0.18 * b, 0.17), bottom))
    if dress.long_coat:
        parts.append(tube((0, 0, 1.2), (0, 0, 0.62), (0.16 * b, 0.23 * b), top, sides=10))
    parts += _head((0.02, 0, 1.66), skin, hair)
    if dress.bag:
        parts.append(box((0.16, 0.28, 0.4), (-0.2, 0, 1.25), bottom))
    return join(*parts).scaled(dress.height / 1.78)


def _head(centre: tuple[float, float, float], skin: Look, hair: Look) -> list[Mesh]:
    c = np.asarray(centre)
    return [
        tube(c - (0.01, 0, 0.2), c - (0, 0, 0.05), (0.055, 0.055), skin, rounded=True),
        ellipsoid(c, (0.1, 0.078, 0.125), skin, detail=2),
        ellipsoid(np.add(c, (-0.022, 0, 0.035)), (0.1, 0.088, 0.115), hair, detail=2),
    ]


def make_cyclist(dress: Dress, phase: float) -> Mesh:
    """A person riding a bicycle at `phase` (0..1) of the pedals; wheels on z = 0."""
    skin, hair, top, bottom, shoe = dress.clothes(SceneClass.CYCLIST)
    parts = [make_bicycle(SceneClass.CYCLIST, top.color)]
    seat, bars, neck = np.array([(-0.25, 0.0, 0.98), (0.42, 0.0, 1.05), (0.16, 0.0, 1.5)])
    for k, sign in enumerate((-1.0, 1.0)):
        turn = 2 * np.pi * (phase + 0.5 * k)
        pedal = np.array([0.17 * np.cos(turn), 0.12 * sign, 0.32 + 0.17 * np.sin(turn)])
        hip, ankle = np.add(seat, (0.0, 0.1 * sign, 0.02)), np.add(pedal, (0, 0, 0.08))
        shoulder = np.add(neck, (-0.03, 0.19 * sign, -0.06))
        hand = np.add(bars, (0, 0.24 * sign, 0.02))
        elbow = (shoulder + hand) / 2 + (-0.05, 0.06 * sign, -0.06)
        parts += _limb((hip, _knee(hip, ankle), ankle), _RIDING[:2], bottom)
        parts.append(ellipsoid(np.add(pedal, (0.05, 0, 0.04)), (0.13, 0.05, 0.05), shoe))
        parts += _limb((shoulder, elbow, hand), _RIDING[2:], top)
        parts.append(ellipsoid(hand, (0.05, 0.04, 0.04), skin))
    back = np.add(seat, (0, 0, 0.05)), neck - (0.03, 0, 0.08)
    parts.append(tube(*back, (0.16, 0.185), top, sides=10, rounded=True))
    cap = replace(hair, color=(0.6, 0.6, 0.6)) if dress.helmet else hair
    return join(*parts, *_head((0.24, 0, 1.68), skin, cap))


def _knee(a: Floats, b: Floats, upper: float = 0.45, lower: float = 0.46) -> Floats:
    """Return the knee of a two-bone leg from a to b, which bends forward in the x-z plane."""
    line = b - a
    reach = min(float(np.linalg.norm(line)), upper + lower - 1e-3)
    along = (upper**2 - lower**2 + reach**2) / (2 * reach)
    out = np.sqrt(max(upper**2 - along**2, 0.0))
    unit = line / np.linalg.norm(line)
    forward = np.array([-unit[2], 0.0, unit[0]])
    forward *= np.sign(forward[0]) or 1.0
    return np.asarray(a + unit * along + forward / np.linalg.norm(forward) * out)


@lru_cache(maxsize=64)
def make_bicycle(label: SceneClass, color: Color) -> Mesh:
    """A bicycle; x forward, wheels on z = 0."""
    rubber = Look(SurfaceKind.PLAIN, (0.02, 0.02, 0.02), label)
    frame = Look(SurfaceKind.METAL, color, label)
    chrome = Look(SurfaceKind.METAL, (0.4, 0.4, 0.4), label)
    parts = []
    for x in (-0.52, 0.55):
        turns = np.linspace(0, 2 * np.pi, 15)
        rim = [(x + 0.34 * np.cos(t), 0.0, 0.345 + 0.34 * np.sin(t)) for t in turns]
        parts += [tube(p, q, (0.022, 0.022), rubber, sides=5) for p, q in pairwise(rim)]
        parts += [tube((x, 0, 0.345), p, (0.006, 0.006), chrome, sides=3) for p in rim[:-1:2]]
    hub, head, crank, saddle = (-0.52, 0, 0.345), (0.4, 0, 0.85), (0, 0, 0.32), (-0.22, 0, 0.85)
    ends = (hub, crank), (hub, saddle), (crank, saddle), (crank, head), (saddle, head)
    for p, q in (*ends, (head, (0.55, 0, 0.345)), (head, (0.38, 0, 1.02))):
        parts.append(tube(p, q, (0.02, 0.02), frame, sides=6))
    parts.append(tube((0.38, -0.28, 1.03), (0.38, 0.28, 1.03), (0.015, 0.015), chrome, sides=5))
    parts.append(box((0.25, 0.14, 0.06), (-0.25, 0, 0.93), rubber))
    return join(*parts)
