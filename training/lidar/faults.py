"""Faults of a LiDAR."""

from typing import Literal

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from runtime.contract.contract import NO_CLASS
from runtime.geometry.projection import project_points

Depth = NDArray[np.float32]
LidarFault = Literal["nan", "shift", "dropout"]

# Share of the measurements that the fault "nan" makes NaN, infinite or negative.
NAN_SHARE = 0.3
# Shift of the whole scan by the fault "shift": right and down [share of the width].
SHIFT = (0.01, 0.004)
# Share of the width, in the middle, without measurements by the fault "dropout".
DROPOUT_SHARE = 1 / 3
# Largest rotation [degrees] about each axis and shift [m] along it of a misaligned LiDAR.
MISALIGNMENT_DEG, MISALIGNMENT_M = 0.5, 0.05
# Range of the share of the image's width that a missing sector has.
SECTOR_SHARE = (0.05, 0.3)
# Largest share of the image that an object may cover in `absorb`.
THING_SHARE = 0.25


def add_fault(fed: Depth, fault: str, rng: Generator) -> Depth:
    """Return a damaged copy of a sparse depth map, float32 (H, W) [m], 0 = no return.

    With "nan", `NAN_SHARE` of the measurements become NaN, infinite or negative, a third each. With
    "shift", the scan is shifted by `SHIFT`, as after a knock on the sensor. With "dropout", the
    middle `DROPOUT_SHARE` of the image has no measurement. "none" changes nothing.
    """
    damaged = fed.copy()
    width = fed.shape[1]
    if fault == "nan":
        row, column = np.nonzero(fed)
        hit = rng.random(len(row)) < NAN_SHARE
        nonsense = np.array([np.nan, np.inf, -1.0], dtype=np.float32)
        damaged[row[hit], column[hit]] = nonsense[rng.integers(0, 3, int(hit.sum()))]
    elif fault == "shift":
        across, down = (max(1, round(part * width)) for part in SHIFT)
        damaged = np.zeros_like(fed)
        damaged[down:, across:] = fed[:-down, :-across]
    elif fault == "dropout":
        start = round((1 - DROPOUT_SHARE) / 2 * width)
        damaged[:, start : width - start] = 0
    return damaged


def misalign(fed: Depth, intrinsics: NDArray[np.float64], rng: Generator) -> Depth:
    """Return the scan as it is projected with a wrong LiDAR extrinsics matrix.

    The error is up to `MISALIGNMENT_DEG` about and `MISALIGNMENT_M` along each axis. Of two returns
    on one pixel the nearer is kept. `fed` is float32 (H, W) [m], 0 = no return; `intrinsics` is
    (3, 3).
    """
    row, column = np.nonzero(fed)
    z = fed[row, column].astype(np.float64)
    pixels = np.stack([column, row, np.ones(len(z))])
    points = (np.linalg.inv(intrinsics) @ pixels * z).T.astype(np.float32)
    moved = np.eye(4)
    angles = np.deg2rad(rng.uniform(-MISALIGNMENT_DEG, MISALIGNMENT_DEG, 3))
    moved[:3, :3] = cv2.Rodrigues(angles)[0]
    moved[:3, 3] = rng.uniform(-MISALIGNMENT_M, MISALIGNMENT_M, 3)
    return project_points(points, intrinsics, moved, (fed.shape[0], fed.shape[1]))


def drop_sectors(fed: Depth, rng: Generator) -> Depth:
    """Return a copy without the returns of one to three sectors: dirt, water, lost packets."""
    kept = fed.copy()
    width = fed.shape[1]
    for _ in range(int(rng.integers(1, 4))):
        columns = round(rng.uniform(*SECTOR_SHARE) * width)
        start = int(rng.integers(0, width - columns + 1))
        kept[:, start : start + columns] = 0
    return kept


def absorb(fed: Depth, semantic: NDArray[np.uint8], rng: Generator) -> Depth:
    """Return a copy without the returns of one thing, or of its upper part: dark paint, glass.

    The thing is the region of one class around a random return. A region of more than `THING_SHARE`
    of the image, such as the road, keeps its returns, and so do pixels without a class.
    """
    kept = fed.copy()
    rows, columns = np.nonzero((fed > 0) & (semantic != NO_CLASS))
    if len(rows):
        index = int(rng.integers(len(rows)))
        region = np.zeros((fed.shape[0] + 2, fed.shape[1] + 2), np.uint8)
        flags = 4 | cv2.FLOODFILL_MASK_ONLY | 1 << 8
        seed = (int(columns[index]), int(rows[index]))
        _, _, _, (_, top, _, height) = cv2.floodFill(
            np.ascontiguousarray(semantic), region, seed, 0, flags=flags
        )
        thing = region[1:-1, 1:-1] > 0
        if thing.mean() <= THING_SHARE:
            # In half of the draws this is below the object, which then has no returns.
            lowest = top + height * rng.uniform(0.4, 1.6)
            kept[: round(lowest)][thing[: round(lowest)]] = 0
    return kept


def add_false_returns(fed: Depth, rng: Generator) -> Depth:
    """Return a copy with returns that show no surface of the image: float32 (H, W) [m].

    About one in 10,000 pixels gets such a return. Half of them are close, like rain or dust, 1.5 to
    10 m away; the others see past a near edge and are 1.3 to 4 times as far as a measurement.
    """
    count = 1 + int(rng.poisson(fed.size / 1e4))
    damaged = fed.copy()
    place = rng.integers(0, fed.size, count)
    damaged.flat[place] = np.exp(rng.uniform(np.log(1.5), np.log(10.0), count))
    measured = np.flatnonzero(fed)
    if measured.size:
        behind = rng.choice(measured, count)
        damaged.flat[behind] *= rng.uniform(1.3, 4.0, count).astype(np.float32)
    return damaged
