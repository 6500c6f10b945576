"""Error and time of the classical methods of depth completion, side by side.

    OMP_NUM_THREADS=1 python benchmarks/depth_completion.py --data DIR [--methods ip-basic ...]
        [--limit FRAMES] [--json OUT]

On KITTI's stream (`DIR/kitti_stream`, frames 50-59; every second scan line fed, the others scored)
and streets (`DIR/kitti_streets`, from 000070 on; 64 and 16 lines fed, accumulated scans scored),
depth up to 100 m. Every frame goes through all methods in turn, on one thread; "ms" is the median
over the frames of the processor's time that a method takes, which other programs do not
lengthen as they do the clock's.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from runtime.engine_facts import cpu_name
from runtime.io.atomic_write import atomic_write
from runtime.run.process import dedicate_process
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.sample import SampleSource
from training.evaluation.classical import METHODS, create_method
from training.evaluation.metrics import DepthScores
from training.evaluation.scoring import split_frames
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset

STREAM = KittiStreamRecipe(path="kitti_stream", first=50, last=59)
STREETS = KittiStreetsRecipe(path="kitti_streets", first=70)
SETS = {
    "KITTI frames 50-59, 32 lines": (STREAM, "own"),
    "KITTI streets, 64 lines": (STREETS, "64"),
    "KITTI streets, 16 lines": (STREETS, "16"),
}


def main() -> None:
    """Print a table a set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--limit", type=int, help="frames of each set, evenly spread")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    dedicate_process()
    print(f"{cpu_name()}, one thread\n")
    rows = []
    for title, (recipe, lidar) in SETS.items():
        source = open_dataset(recipe, [arguments.data], classes="camvid")
        count = min(arguments.limit or len(source), len(source))
        indices = np.unique(np.linspace(0, len(source) - 1, count).round().astype(int))
        print(f"{title}, {len(indices)} frames\n")
        print("| method | MAE mm | RMSE mm | ms | no answer % |\n|---|---|---|---|---|")
        for row in measure(arguments.methods, source, indices.tolist(), LidarInput.parse(lidar)):
            print(
                f"| {row['method']} | {row['mae_mm']:.0f} | {row['rmse_mm']:.0f} | {row['ms']:.1f} "
                f"| {row['no_answer_percent']:.2f} |"
            )
            rows.append({"set": title, "frames": len(indices), **row})
        print()
    if arguments.json:
        atomic_write(arguments.json, json.dumps(rows, indent=2).encode())


def measure(
    names: list[str], source: SampleSource, indices: list[int], lidar: LidarInput
) -> list[dict[str, str | float]]:
    """Return a row a method: errors over all scored pixels, median time, share of pixels at 0."""
    methods = {name: create_method(name) for name in names}
    scores = {name: DepthScores() for name in names}
    times_ms: dict[str, list[float]] = {name: [] for name in names}
    unanswered: dict[str, list[float]] = {name: [] for name in names}
    for frame in tqdm(split_frames(source, indices, lidar), total=len(indices), disable=None):
        for name, method in methods.items():
            started = time.process_time()
            depth = method.complete(frame.sample.rgb, frame.fed)
            times_ms[name].append((time.process_time() - started) * 1e3)
            scores[name].update(depth, frame.target)
            unanswered[name].append(float((depth == 0).mean()))
    rows: list[dict[str, str | float]] = []
    for name in names:
        errors = scores[name].compute()
        rows.append(
            {
                "method": name,
                "mae_mm": errors.mae_m * 1e3,
                "rmse_mm": errors.rmse_m * 1e3,
                "ms": statistics.median(times_ms[name]),
                "no_answer_percent": 100 * statistics.mean(unanswered[name]),
            }
        )
    return rows


if __name__ == "__main__":
    main()
