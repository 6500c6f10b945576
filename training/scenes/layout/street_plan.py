"""Cross-section of a street: lanes, parking, verges, pavements and side roads."""

from dataclasses import dataclass

from numpy.random import Generator

from training.scenes.names import StreetKind

#: Height of the kerbs, and where streets start and end.
KERB_M = 0.12
START_M = -40.0
END_M = 330.0


@dataclass(frozen=True)
class Plan:
    """Cross-section of the street; everything in metres from the centre line.

    side: +1 traffic keeps right, -1 keeps left. Own lanes are at -side * d.
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

    def blocks(self, end: float, margin: float = 0.0) -> list[tuple[float, float]]:
        """Start and end of each block between side roads, from `START_M` to ``end``."""
        starts = [START_M, *(c + self.crossing_half + margin for c in self.crossings)]
        ends = [*(c - self.crossing_half - margin for c in self.crossings), end]
        return list(zip(starts, ends, strict=True))

    def free(self, s: float, margin: float = 0.0) -> bool:
        """Whether s is clear of every side road."""
        return all(abs(s - c) > self.crossing_half + margin for c in self.crossings)


def draw_plan(rng: Generator, kind: StreetKind, side: float) -> Plan:
    avenue, highway, square = (int(rng.integers(1, end)) for end in (3, 3, 4))
    lanes = {"avenue": avenue, "highway": highway, "square": square}.get(kind, 1)
    lane = float(rng.uniform(3.0, 3.7))
    parking = (
        2.2
        if kind in ("town", "residential") and rng.random() < 0.7
        else (0.5 if kind != "highway" else 1.5)
    )
    verges = {"residential": float(rng.choice([0.0, 1.5])), "avenue": float(rng.uniform(1.5, 4))}
    verge = verges.get(kind, 0.0)
    pavement = 0.0 if kind == "highway" and rng.random() < 0.6 else float(rng.uniform(1.8, 4.5))
    crossings: list[float] = []
    where = float(rng.uniform(12, 70))
    while where < 260 and kind != "highway":
        crossings.append(where)
        where += float(rng.uniform(45, 120))
    if kind == "highway" and rng.random() < 0.3:
        crossings = [float(rng.uniform(40, 90))]
    half = float(rng.uniform(3.2, 5.5))
    return Plan(kind, side, lane, lanes, parking, verge, pavement, tuple(crossings), half)


def lane_centre(plan: Plan, lane: int, *, own: bool = True) -> float:
    """Centre of an own or oncoming lane; lane 0 is next to the centre line."""
    d = -plan.side * plan.lane * (lane + 0.5)
    return d if own else -d
