"""Time of projecting a whole LiDAR scan into a camera, on one core.

    python benchmarks/projection.py [--rounds 200] [--keep-memory]

The scan is that of a 64-line sensor on a street with walls, 115,200 returns all around; the picture
has 1242 x 375 pixels. The plain and the filtered projection, the projection through each model of a
lens, and that of returns moved by the poses at their own times (`project_compensated`, poses at
100 Hz) run interleaved. With --keep-memory, freed memory is kept for the next scan, as ssdnet-run
keeps it.
"""

import argparse
import os
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import project_points
from runtime.app.run.pipeline import dedicate_process
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import project_compensated
from runtime.geometry.poses import PoseTrack

SIZE = (375, 1242)
INTRINSICS = np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])
# From x ahead, y left, z up to the camera, which is 0.27 m in front of and 0.08 m below the LiDAR.
EXTRINSICS = np.array([[0.0, -1, 0, 0.06], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
HEIGHT_M = 1.73
LENSES = {
    "plumb_bob": [-0.37, 0.2, 1e-3, -1e-3, -0.07],
    "rational_polynomial": [0.6, -0.02, 1e-3, 2e-4, 1e-3, 0.95, 0.06, 2e-3],
    "equidistant": [0.01, -0.004, 1e-3, -2e-4],
}


def street_scan(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return 64 lines of 1,800 firings, float32 (115200, 4), with a road below and walls around."""
    elevation = np.concatenate([2 - np.arange(32) / 3, -8.83 - np.arange(32) / 2])
    azimuth, elevation = (
        np.deg2rad(angles).ravel()
        for angles in np.meshgrid(np.arange(1800) / 5, elevation, indexing="xy")
    )
    # Sixty walls of 6 degrees each, from a distance of 5 m on.
    wall = (5 + rng.gamma(2.0, 8.0, 60))[np.rint(azimuth * 900 / np.pi).astype(int) // 30]
    road = HEIGHT_M / np.maximum(1e-3, -np.sin(elevation))
    distance = np.minimum(wall, road)
    x = distance * np.cos(elevation) * np.cos(azimuth)
    y = distance * np.cos(elevation) * np.sin(azimuth)
    points = np.column_stack([x, y, distance * np.sin(elevation), rng.random(len(x))])
    return points.astype(np.float32)


def _pose(stamp_ns: int) -> NDArray[np.float64]:
    """Return the LiDAR's pose on a circle, at 15 m/s and 0.5 rad/s."""
    angle = 0.5 * stamp_ns / 1e9
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:2, 3] = 30 * np.sin(angle), 30 * (1 - np.cos(angle))
    return pose


def main() -> None:
    """Print median and 99th percentile of each way, in milliseconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--keep-memory", action="store_true")
    arguments = parser.parse_args()
    rounds = arguments.rounds
    if arguments.keep_memory:
        dedicate_process()
    cv2.setNumThreads(1)
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    points = street_scan(np.random.default_rng(0))
    stamps = range(-20_000_000, 130_000_000, 10_000_000)
    track = PoseTrack.of([_pose(stamp) for stamp in stamps], stamps)
    times = np.tile(np.linspace(0, 100_000_000, 1800).astype(np.int64), 64)
    calibration = Calibration(INTRINSICS, EXTRINSICS)
    ways: dict[str, Callable[[], NDArray[np.float32]]] = {
        "plain": lambda: project_points(points, INTRINSICS, EXTRINSICS, SIZE),
        **{
            f"lens {lens}": partial(
                Calibration(INTRINSICS, EXTRINSICS, lens=lens, distortion=distortion).project,
                points,
                SIZE,
            )
            for lens, distortion in LENSES.items()
        },
        "moved and projected": lambda: project_compensated(
            calibration, points, times, track, 50_000_000, SIZE
        ),
    }
    times_ms: dict[str, list[float]] = {name: [] for name in ways}
    returns = {name: np.count_nonzero(way()) for name, way in ways.items()}
    for _ in range(rounds):
        for name, way in ways.items():
            start = time.perf_counter()
            way()
            times_ms[name].append(1000 * (time.perf_counter() - start))
    print(f"{len(points)} returns to {SIZE[1]} x {SIZE[0]}, one core, n = {rounds}\n")
    print("| projection | pixels with a return | median ms | p99 ms |")
    print("|---|---|---|---|")
    for name, times in times_ms.items():
        median, p99 = np.percentile(times, [50, 99])
        print(f"| {name} | {returns[name]} | {median:.2f} | {p99:.2f} |")


if __name__ == "__main__":
    main()
