"""Depth of cameras that no training frame is from, with and without their focal length.

    python benchmarks/cameras.py MODEL [MODEL ...] --data DIR [--size 540 ...]

- large: the frames of DIR/pandaset_front, 1920 x 1080 pixels with fx 1970. One LiDAR is fed, 64
  lines all around, and the returns of the other one, which looks ahead, are the truth where no
  fed return is.
- half, quarter: the same, fed with that share of the returns; few: with returns of FEW_SHARE of the
  pixels.
- forward: the other LiDAR is fed, and the first one is the truth.
- wide: the frames of DIR/rendered/wide (`ssdnet-render DIR/rendered/wide --camera varied --frames 1
  --scenes 24 --seed 910000`) whose image is over 80 degrees wide, with the rendered LiDAR.

MODEL is a bundled name, an exported file or a checkpoint with depth, or a classical method. MAE,
RMSE and median of the absolute errors are means over frames, of the true depths up to 100 m. All
get the returns up to 100 m alone, and a depth beyond counts as 100 m: otherwise a method that does
not know them would be ahead. Each --size is as in ssdnet-eval.
"""

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import project_points
from runtime.bundled_models import find_model
from runtime.network_size import parse_network_size
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.classical import METHODS
from training.evaluation.evaluate import short_names
from training.evaluation.scored_model import open_method, open_model
from training.evaluation.scoring import Predict
from training.loading.open_dataset import open_dataset

WIDE_DEG = 80.0
FARTHEST_M = 100.0
#: All around, and forward.
DEVICES = (0, 1)
FEW_SHARE = 0.002


class Frame(NamedTuple):
    """A frame and its truth; maps are float32 (H, W) [m], 0 = none."""

    rgb: NDArray[np.uint8]
    fed: NDArray[np.float32]
    truth: NDArray[np.float32]
    focal_length_px: float


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", metavar="MODEL")
    parser.add_argument("--data", type=Path, required=True, action="append")
    parser.add_argument("--size", nargs="+", default=["auto"])
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    large = read_large(arguments.data)
    cameras = {
        "large": large,
        "half": [thin(frame, 0.5, number) for number, frame in enumerate(large)],
        "quarter": [thin(frame, 0.25, number) for number, frame in enumerate(large)],
        "few": [
            thin(frame, FEW_SHARE * frame.fed.size / np.count_nonzero(frame.fed), number)
            for number, frame in enumerate(large)
        ],
        "forward": read_large(arguments.data, devices=DEVICES[::-1]),
        "wide": read_wide(arguments.data),
    }
    print("| model | size | focal length | " + " | ".join(cameras) + " |")
    print("|---|---|---|" + "---|" * len(cameras))

    def print_row(title: str, predict: Predict, *, focal: bool) -> None:
        cells = []
        for frames in cameras.values():
            mae, rmse, median = (1000 * score(predict, frames, focal=focal)).round().astype(int)
            cells.append(f"{mae} / {rmse}, {median}")
        print(f"| {title} | {'given' if focal else ''} | {' | '.join(cells)} |", flush=True)

    methods = [name for name in arguments.models if name in METHODS]
    for name in methods:
        print_row(f"{name} | ", open_method(name).predict, focal=False)
    names = [name for name in arguments.models if name not in methods]
    paths = [Path(name) if name.endswith(".pt") else find_model(name) for name in names]
    for title, path in zip(short_names(paths), paths, strict=True):
        for size in arguments.size:
            asked = parse_network_size(size)
            with open_model(path, threads=arguments.threads, size=asked) as model:
                for focal in (False, True):
                    print_row(f"{title} | {size}", model.predict, focal=focal)


def read_large(folders: Sequence[Path], devices: tuple[int, int] = DEVICES) -> list[Frame]:
    """Read the frames of `pandaset_front`; devices: the LiDAR that is fed, and the truth."""
    (root,) = (found for folder in folders if (found := folder / "pandaset_front").is_dir())
    camera = json.loads((root / "intrinsics.json").read_text())
    rows = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
    matrix = np.array(rows, np.float64)
    frames = []
    for path in sorted((root / "image").glob("*.jpg")):
        rgb = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        points = np.fromfile(root / "points" / f"{path.stem}.bin", np.float32).reshape(-1, 6)
        fed, other = (
            project_points(points[points[:, 4] == device, :3], matrix, np.eye(4), rgb.shape[:2])
            for device in devices
        )
        frames.append(Frame(rgb, fed, np.where(fed > 0, np.float32(0), other), camera["fx"]))
    return frames


def thin(frame: Frame, share: float, seed: int) -> Frame:
    """Feed a random share of the returns; the truth stays."""
    fed = np.flatnonzero(frame.fed)
    count = round(min(share, 1.0) * len(fed))
    kept = np.random.default_rng(seed).choice(fed, count, replace=False)
    few = np.zeros_like(frame.fed)
    few.flat[kept] = frame.fed.flat[kept]
    return frame._replace(fed=few)


def read_wide(folders: Sequence[Path]) -> list[Frame]:
    """Read the rendered frames whose image is over WIDE_DEG wide."""
    recipe = RenderedRecipe(path="rendered/wide", scans=True)
    source = open_dataset(recipe, list(folders), classes="camvid")
    samples = (source[index] for index in range(len(source)))
    return [
        Frame(item.rgb, item.sparse_depth, item.depth, item.focal_length_px)
        for item in samples
        if 2 * math.atan(item.size[1] / 2 / item.focal_length_px) > math.radians(WIDE_DEG)
    ]


def score(predict: Predict, frames: Sequence[Frame], *, focal: bool) -> NDArray[np.float64]:
    """Return MAE, RMSE and median error [m] up to FARTHEST_M, means over frames, (3,)."""
    figures = []
    for frame in frames:
        fed = np.where(frame.fed > FARTHEST_M, np.float32(0), frame.fed)
        answer = predict(frame.rgb, fed, frame.focal_length_px if focal else None)
        known = (frame.truth > 0) & (frame.truth <= FARTHEST_M)
        error = np.abs(np.minimum(answer.depth[known], FARTHEST_M) - frame.truth[known])
        figures.append((error.mean(), math.sqrt(np.square(error).mean()), np.median(error)))
    return np.mean(figures, axis=0)


if __name__ == "__main__":
    main()
