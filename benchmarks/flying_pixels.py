"""How many points of a cloud fly between objects, and how many boundary and uncertainty remove.

    python benchmarks/flying_pixels.py --data DIR [--limit 8] [--threads 2]

A point flies between a near and a far surface if some true depths within 3 pixels of it are nearer
and some farther, and all differ by more than 10 % and 0.5 m. Points whose true depth is below 80 m
are counted, in the rendered scenes of DIR/rendered/val (`ssdnet-render`), whose ground truth is
dense.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime import Predictor
from training.datasets.virtual_kitti import RenderedRecipe
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset
from training.scores.scoring import split_frames

FARTHEST_M = 80.0
AROUND_PX = 3
# Options of `Prediction.points`; the first entry keeps all points.
CLOUDS: tuple[dict[str, Any], ...] = (
    {"edge_boundary": None},
    *({"edge_boundary": edge} for edge in (0.5, 0.45, 0.35, 0.25, 0.15)),
    *({"max_uncertainty": share} for share in (0.1, 0.05, 0.03, 0.02)),
    {"voxel_m": 0.1},
    {"voxel_m": 0.1, "max_uncertainty": 0.05},
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", help="bundled name or path")
    parser.add_argument("--limit", type=int, default=8, help="frames")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    source = open_dataset(RenderedRecipe(path="rendered/val"), [arguments.data], classes="camvid")
    indices = np.linspace(0, len(source) - 1, arguments.limit).astype(int).tolist()
    counts = np.zeros((len(CLOUDS), 2), dtype=np.int64)  # number of points, and of flying ones
    with Predictor(arguments.model, threads=arguments.threads) as predictor:
        for sample, fed, _ in split_frames(source, indices, LidarInput("own")):
            prediction = predictor.predict(sample.rgb, fed, focal_length_px=sample.focal_length_px)
            near = (sample.depth > 0) & (sample.depth < FARTHEST_M)
            flying = flies(prediction.depth, sample.depth)
            for place, options in enumerate(CLOUDS):
                cloud = prediction.points(sample.intrinsics, keep_sky=True, **options)
                counted = near[cloud.rows, cloud.columns]
                bad = flying[cloud.rows, cloud.columns]
                counts[place] += np.count_nonzero(counted), np.count_nonzero(counted & bad)
    print(f"{len(indices)} frames\n")
    print("| options | points | of all | flying | share of points | removed of the flying |")
    print("|" + "---|" * 6)
    all_points, all_flying = counts[0]
    for options, (points, bad) in zip(CLOUDS, counts, strict=True):
        named = ", ".join(f"{name} {value}" for name, value in options.items())
        print(
            f"| {named} | {points:,} | {points / all_points:.1%} | {bad:,} | {bad / points:.2%} | "
            f"{1 - bad / all_flying:.1%} |"
        )


def flies(depth: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the pixels between the true depths around them, near none; 0 in the truth is sky."""
    height, width = depth.shape
    beyond = np.pad(np.where(truth > 0, truth, np.float32(np.inf)), AROUND_PX, mode="edge")
    tolerance = np.maximum(np.float32(0.5), np.float32(0.1) * depth)
    nearer, farther, touched = (np.zeros(depth.shape, dtype=np.bool_) for _ in range(3))
    for row in range(2 * AROUND_PX + 1):
        for column in range(2 * AROUND_PX + 1):
            there = beyond[row : row + height, column : column + width]
            nearer |= there < depth - tolerance
            farther |= there > depth + tolerance
            touched |= np.abs(there - depth) <= tolerance
    return nearer & farther & ~touched


if __name__ == "__main__":
    main()
