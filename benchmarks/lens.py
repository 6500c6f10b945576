"""Depth of a camera with a distorting lens: ignored, rectified, and projected through the lens.

    python benchmarks/lens.py --data DIR [--model ssdnet-lite] [--frames 10]

The frames of DIR/pandaset_front are distorted with k1 = -0.35 and enlarged so that they fill the
image. One LiDAR is fed. The truth are the returns of the other LiDAR that the rectified image
contains, at their true pixels, without pixels of fed returns. The sides are the outer sixths of the
rectified image. MAE and median of the absolute errors up to 100 m are means over frames.
"""

import argparse
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rigs import pandaset_frames
from runtime import Predictor
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import cache_key, rays
from runtime.geometry.projection import project_with_rows
from training.scores.metrics import FARTHEST_M

K1, ENLARGED = -0.35, 1.12
SIDES = 1 / 6
# The LiDAR that sees all around is fed, and the one that looks ahead is the truth.
DEVICES = (0, 1)


class Way(NamedTuple):
    """An image, the calibration with which its scan is projected, and its true calibration."""

    rgb: NDArray[np.uint8]
    calibration: Calibration
    true: Calibration


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", default="ssdnet-lite")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    errors: dict[str, list[NDArray[np.float64]]] = {}
    with Predictor(arguments.model, threads=arguments.threads) as predictor:
        for rgb, points, calibration in read_distorted(arguments.data, arguments.frames):
            straight = calibration.rectified
            ways = {
                "no lens": Way(rgb, straight, calibration),
                "rectified": Way(calibration.rectify(rgb), straight, straight),
                "through the lens": Way(rgb, calibration, calibration),
            }
            fed, truth = (points[points[:, 4] == device, :3] for device in DEVICES)
            rows = project_with_rows(truth, straight.intrinsics, np.eye(4), rgb.shape[:2]).rows
            truth = truth[rows[rows >= 0]]  # the points that the rectified image contains
            for name, way in ways.items():
                scores = score(predictor, way, straight, fed, truth)
                errors.setdefault(name, []).append(scores)
    print("| | MAE mm | median | sides: MAE | median |\n|---|---|---|---|---|")
    for name, scores in errors.items():
        cells = (1000 * np.mean(scores, axis=0)).round().astype(int)
        print(f"| {name} | {' | '.join(map(str, cells))} |")


def read_distorted(
    data: Path, frames: int
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float32], Calibration]]:
    """Yield images as the lens would have taken them, float32 (N, 6) points, and calibrations."""
    for rgb, points, matrix in islice(pandaset_frames(data / "pandaset_front"), frames):
        enlarged = matrix * [[ENLARGED, 1, 1], [1, ENLARGED, 1], [1, 1, 1]]
        calibration = Calibration(
            enlarged, np.eye(4), lens="plumb_bob", distortion=[K1, 0.0, 0.0, 0.0, 0.0]
        )
        table = rays(calibration.lens_model, cache_key(enlarged), rgb.shape[:2])
        column, row = (
            (table[..., axis] * matrix[axis, axis] + matrix[axis, 2]).astype(np.float32)
            for axis in (0, 1)
        )
        yield cv2.remap(rgb, column, row, cv2.INTER_LINEAR), points, calibration


def score(
    predictor: Predictor,
    way: Way,
    straight: Calibration,
    fed: NDArray[np.float32],
    truth: NDArray[np.float32],
) -> NDArray[np.float64]:
    """Return MAE and median error [m] of all pixels and of the sides, (4,)."""
    size = way.rgb.shape[:2]
    sparse_depth = way.calibration.project(fed, size)
    focal_px = way.calibration.focal_length_px
    answer = predictor.predict(way.rgb, sparse_depth, focal_length_px=focal_px)
    depth, rows = project_with_rows(
        truth, way.true.intrinsics, np.eye(4), size, lens=way.true.lens_model
    )
    known = (depth > 0) & (depth <= FARTHEST_M) & (way.true.project(fed, size) == 0)
    seen = truth[rows[known]]
    column = seen[:, 0] / seen[:, 2] * straight.intrinsics[0, 0] + straight.intrinsics[0, 2]
    is_side = np.abs(column / size[1] - 0.5) > 0.5 - SIDES
    error = np.abs(answer.depth[known] - depth[known]).astype(np.float64)
    sides = error[is_side]
    return np.array([error.mean(), np.median(error), sides.mean(), np.median(sides)])


if __name__ == "__main__":
    main()
