"""Depth on every rig at hand: what a choice of the network is decided on.

    python benchmarks/rigs.py MODEL [MODEL ...] --data DIR [--data DIR ...]

MODEL is a bundled name, an exported file or a checkpoint with depth, or a classical method. All
frames are at most ROWS rows high, and every model runs at their size, except in the sets of
FULL_SIZE: there frames have the camera's own size, and a model runs as it does by default. `SETS`
has the frames, and which returns are fed; the others, or a denser truth, are scored up to 100 m,
without those behind a nearer return (`OcclusionFilter`, whose window grows with the picture). A set
whose folder is missing is left out. NARROW leaves out less: half of the error is then of returns
that are seen through gaps between scan lines.

MAE / RMSE, median of the absolute errors in mm, means over frames. All models get the returns up to
100 m alone, and a depth beyond counts as 100 m: a method that does not know them would be ahead.
The last columns are the means over the sets, without those of ASIDE, of the MAE and of the RMSE,
each divided by that of the better of REFERENCES: below 1 the model beats what needs no learning.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import project_points
from runtime.engine.bundled_models import find_model
from runtime.geometry.calibration import Calibration
from runtime.recordings.images import read_rgb
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.classical import METHODS
from training.evaluation.open_model import open_method, open_scored_model
from training.lidar.simulate import random_share
from training.lidar.split import LidarInput, OcclusionFilter, frame_generator, split_lidar
from training.loading.open_dataset import open_dataset
from training.scores.evaluated_set import short_names
from training.scores.metrics import FARTHEST_M, frame_errors
from training.scores.scoring import Predict

ROWS, FULL = 400, 100_000
WIDE_DEG = 80.0
REFERENCES = ("linear", "planes")
HIDDEN, NARROW = OcclusionFilter(), OcclusionFilter((3, 3), 0.1, 0.0)
Depth = NDArray[np.float32]


class Frame(NamedTuple):
    """A frame and its truth; maps are float32 (H, W) [m], 0 = none."""

    rgb: NDArray[np.uint8]
    fed: Depth
    truth: Depth
    focal_length_px: float | None


Read = Callable[[Sequence[Path]], Iterator[Frame]]


def find_folder(folders: Sequence[Path], name: str) -> Path | None:
    """Return the data set's folder; None if there is none."""
    return next((folder / name for folder in folders if (folder / name).is_dir()), None)


def read_dataset(recipe: SourceRecipe, lidar: str, folders: Sequence[Path]) -> Iterator[Frame]:
    """Read the frames of a data set with this LiDAR, see `LidarInput.parse`."""
    source = open_dataset(recipe, list(folders), classes="camvid")
    for index in range(len(source)):
        split = split_lidar(source[index], LidarInput.parse(lidar), frame_generator(index))
        if split is not None:
            yield Frame(split.sample.rgb, split.fed, split.target, split.sample.focal_length_px)


def read_raw_half(recipe: SourceRecipe, folders: Sequence[Path]) -> Iterator[Frame]:
    """Feed a random half of the recorded returns; the others are the truth."""
    source = open_dataset(recipe, list(folders), classes="camvid")
    for index in range(len(source)):
        sample = source[index]
        whole = Frame(sample.rgb, sample.depth, sample.depth, sample.focal_length_px)
        yield withhold(whole, 0.5, index)


def read_wide(folders: Sequence[Path]) -> Iterator[Frame]:
    """Read the rendered frames whose image is over WIDE_DEG wide."""
    for frame in read_dataset(RenderedRecipe(path="rendered/wide", scans=True), "own", folders):
        assert frame.focal_length_px is not None
        if 2 * math.atan(frame.rgb.shape[1] / 2 / frame.focal_length_px) > math.radians(WIDE_DEG):
            yield frame


def read_pandaset(
    fed: int,
    truth: int,
    share: float,
    folders: Sequence[Path],
    *,
    hidden: OcclusionFilter = HIDDEN,
    rows: int | None = None,
) -> Iterator[Frame]:
    """Read the frames of PandaSet's front camera, reduced to a number of rows.

    Args:
        fed: LiDAR whose returns are fed: 0 = all around, 1 = forward.
        truth: LiDAR whose returns are scored where none is fed; if it is the same, those withheld.
        share: of the returns that are fed.
        folders: of the data.
        hidden: what is left out of the truth.
        rows: of the pictures, at most; None = ROWS.
    """
    root = find_folder(folders, "pandaset_front")
    assert root is not None
    for index, (rgb, points, matrix) in enumerate(pandaset_frames(root)):
        rgb, intrinsics = reduce(rgb, matrix, rows or ROWS)
        size = (rgb.shape[0], rgb.shape[1])
        first, second = (
            project_points(points[points[:, 4] == device, :3], intrinsics, np.eye(4), size)
            for device in (fed, truth)
        )
        whole = Frame(rgb, first, second, intrinsics[0, 0])
        yield withhold(whole, share, index, hidden)


def pandaset_frames(
    root: Path,
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64]]]:
    """Yield picture, points (N, 6), whose fifth column is their LiDAR, and K of each frame."""
    camera = json.loads((root / "intrinsics.json").read_text())
    rows = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
    for path in sorted((root / "image").glob("*.jpg")):
        points = np.fromfile(root / "points" / f"{path.stem}.bin", np.float32).reshape(-1, 6)
        yield read_rgb(path), points, np.array(rows, np.float64)


def read_delft(
    share: float,
    folders: Sequence[Path],
    *,
    hidden: OcclusionFilter = HIDDEN,
    rows: int | None = None,
) -> Iterator[Frame]:
    """Read the frames of View-of-Delft, of whose returns a share is fed."""
    root = find_folder(folders, "view_of_delft")
    assert root is not None
    for index, path in enumerate(sorted((root / "image").glob("*.jpg"))):
        calibration = Calibration.from_kitti(root / "calib" / f"{path.stem}.txt")
        points = np.fromfile(root / "velodyne" / f"{path.stem}.bin", np.float32).reshape(-1, 4)
        rgb, intrinsics = reduce(read_rgb(path), calibration.intrinsics, rows or ROWS)
        size = (rgb.shape[0], rgb.shape[1])
        returns = project_points(points, intrinsics, calibration.extrinsics, size)
        yield withhold(Frame(rgb, returns, returns, intrinsics[0, 0]), share, index, hidden)


def reduce(
    rgb: NDArray[np.uint8], intrinsics: NDArray[np.float64], rows: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Reduce a picture to a number of rows, with its intrinsics."""
    height, width = rgb.shape[:2]
    if height <= rows:
        return rgb, intrinsics
    size = (rows, round(width * rows / height))
    scaled = intrinsics.copy()
    for axis, (new, old) in enumerate(zip(size[::-1], (width, height), strict=True)):
        scaled[axis] *= new / old
        scaled[axis, 2] += 0.5 * new / old - 0.5  # integers are pixel centres
    reduced = cv2.resize(rgb, size[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, np.uint8), scaled


def withhold(frame: Frame, share: float, seed: int, hidden: OcclusionFilter = HIDDEN) -> Frame:
    """Feed a random share of the returns; the truth has no fed one, and none that is hidden."""
    fed = random_share(frame.fed, share, np.random.default_rng(seed)) if share < 1 else frame.fed
    truth = np.where(fed > 0, np.float32(0), frame.truth)
    returns = np.where(frame.fed > 0, frame.fed, frame.truth)
    return frame._replace(fed=fed, truth=magnified(hidden, len(returns)).apply(truth, returns))


def magnified(hidden: OcclusionFilter, rows: int) -> OcclusionFilter:
    """Enlarge the window of a filter for ROWS rows to a picture of more rows; sides stay odd."""
    height, width = (2 * round(side // 2 * max(1.0, rows / ROWS)) + 1 for side in hidden.window)
    return replace(hidden, window=(height, width))


_STREETS = KittiStreetsRecipe(path="kitti_streets", first=70)
_RAW = replace(_STREETS, truth="scan")
_STREAM = KittiStreamRecipe(path="kitti_stream", first=50)
_DRIVE = KittiStreamRecipe(path="kitti_drive_0009", first=30)
#: Name -> folder, and what reads its frames.
SETS: Mapping[str, tuple[str, Read]] = {
    "streets, 64 lines": ("kitti_streets", partial(read_dataset, _STREETS, "64")),
    "16 lines": ("kitti_streets", partial(read_dataset, _STREETS, "16")),
    "4 lines": ("kitti_streets", partial(read_dataset, _STREETS, "4")),
    "streets, raw half": ("kitti_streets", partial(read_raw_half, _RAW)),
    "drive 0009, 16 lines": ("kitti_drive_0009", partial(read_dataset, _DRIVE, "16")),
    "KITTI 50 to 59, 32 lines": ("kitti_stream", partial(read_dataset, _STREAM, "32")),
    "PandaSet, cross": ("pandaset_front", partial(read_pandaset, 0, 1, 1.0)),
    "half": ("pandaset_front", partial(read_pandaset, 0, 0, 0.5)),
    "quarter": ("pandaset_front", partial(read_pandaset, 0, 0, 0.25)),
    "forward": ("pandaset_front", partial(read_pandaset, 1, 0, 1.0)),
    "Delft, half": ("view_of_delft", partial(read_delft, 0.5)),
    "Delft, quarter": ("view_of_delft", partial(read_delft, 0.25)),
    "PandaSet, full size": ("pandaset_front", partial(read_pandaset, 0, 0, 0.5, rows=FULL)),
    "Delft, full size": ("view_of_delft", partial(read_delft, 0.5, rows=FULL)),
    "rendered, wide": ("rendered/wide", read_wide),
    "PandaSet, half, narrow": ("pandaset_front", partial(read_pandaset, 0, 0, 0.5, hidden=NARROW)),
    "Delft, half, narrow": ("view_of_delft", partial(read_delft, 0.5, hidden=NARROW)),
}
#: Sets at the camera's own size, where a model runs at the size that it chooses.
FULL_SIZE = ("PandaSet, full size", "Delft, full size")
#: Sets that no mean is over.
ASIDE = (*FULL_SIZE, "rendered, wide", "PandaSet, half, narrow", "Delft, half, narrow")


def score(predict: Predict, frames: Sequence[Frame]) -> NDArray[np.float64]:
    """Return MAE, RMSE and median error [m] up to FARTHEST_M, means over frames, (3,)."""
    figures = []
    for frame in frames:
        fed = np.where(frame.fed > FARTHEST_M, np.float32(0), frame.fed)
        answer = predict(frame.rgb, fed, frame.focal_length_px)
        assert answer.depth is not None
        figures.append(frame_errors(answer.depth, frame.truth))
    return np.mean(figures, axis=0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", metavar="MODEL")
    parser.add_argument("--data", type=Path, required=True, action="append")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    sets = {
        name: list(read(arguments.data))
        for name, (folder, read) in SETS.items()
        if find_folder(arguments.data, folder)
    }
    print(f"| model | {' | '.join(sets)} | MAE | RMSE |\n{'|---' * (len(sets) + 3)}|")

    def scores_of(predict: Predict, full_size: Predict | None = None) -> NDArray[np.float64]:
        found = [
            score(full_size if full_size and name in FULL_SIZE else predict, frames)
            for name, frames in sets.items()
        ]
        return np.array(found)

    references = {name: scores_of(open_method(name).predict) for name in REFERENCES}
    best = np.min([figures[:, :2] for figures in references.values()], axis=0)

    counted = [name not in ASIDE for name in sets]

    def print_row(title: str, figures: NDArray[np.float64]) -> None:
        cells = [f"{mae:.0f} / {rmse:.0f}, {middle:.0f}" for mae, rmse, middle in 1000 * figures]
        ratios = [f"{ratio:.3f}" for ratio in (figures[:, :2] / best)[counted].mean(axis=0)]
        print(f"| {title} | {' | '.join((*cells, *ratios))} |", flush=True)

    for name, figures in references.items():
        print_row(name, figures)
    others = [name for name in arguments.models if name not in references]
    for name in others:
        if name in METHODS:
            print_row(name, scores_of(open_method(name).predict))
    names = [name for name in others if name not in METHODS]
    paths = [Path(name) if name.endswith(".pt") else find_model(name) for name in names]
    for title, path in zip(short_names(paths), paths, strict=True):
        open_at = partial(open_scored_model, path, threads=arguments.threads)
        with open_at(size="frame") as model, open_at() as full_size:
            print_row(title, scores_of(model.predict, full_size.predict))


if __name__ == "__main__":
    main()
