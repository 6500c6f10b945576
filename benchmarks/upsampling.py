"""How the depth of a network that ran small comes back to the frame's size: ways side by side.

    python benchmarks/upsampling.py --data DIR/kitti_streets [--every 4] [--model NAME|PATH]

Every frame is brought to fewer rows, the network runs there, and its depth is brought back in each
way and scored on the semi-dense truth. "enlarged" frames are magnified first, as a stand-in for a
camera of more pixels: their returns are moved, their metres stay.

- MAE over all truth up to 100 m, and over its edges: pixels with truth more than a quarter nearer
  or farther within 4 px.
- in the air: share of the edge pixels whose depth lies between the two surfaces, more than 10 %
  from either. "at the frame's size" is the network run there: the smear that is its own.
- ms: of that step alone, one thread.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import Predictor
from runtime.engine_facts import cpu_name
from runtime.resize import resize_nearest
from training.datasets.kitti_streets import KittiStreets
from training.datasets.sample import Sample
from training.loading.augment import resize

Depth = NDArray[np.float32]
Picture = NDArray[np.uint8]
#: (depth of the network, its picture, the frame's picture) -> depth at the frame's size.
Way = Callable[[Depth, Picture, Picture], Depth]

#: (enlargement of the frame, rows at which the network runs).
CASES = ((1, 188), (1, 125), (3, 400))
EDGE_RATIO, EDGE_WINDOW = 1.25, 9
AIR_SHARE = 0.1
MAX_DEPTH_M = 100.0


def nearest(depth: Depth, small: Picture, rgb: Picture) -> Depth:
    """Each pixel takes the nearest centre."""
    return resize_nearest(depth, rgb.shape[:2])


def bilinear(depth: Depth, small: Picture, rgb: Picture) -> Depth:
    """Straight lines between centres."""
    return cv2.resize(depth, rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def bilinear_within_surfaces(depth: Depth, small: Picture, rgb: Picture) -> Depth:
    """Bilinear where that changes the nearest depth by less than 5 %, else nearest."""
    smooth, plain = bilinear(depth, small, rgb), nearest(depth, small, rgb)
    edge = cv2.compare(cv2.absdiff(smooth, plain), 0.05 * plain, cv2.CMP_GT)
    return np.where(edge > 0, plain, smooth)


def guided(depth: Depth, small: Picture, rgb: Picture) -> Depth:
    """Of the 2 x 2 nearest centres the one whose colour is nearest to the pixel's."""
    everywhere = np.arange(rgb.shape[0] * rgb.shape[1])
    return _nearest_color(depth, small, rgb, everywhere).reshape(rgb.shape[:2])


def guided_at_edges(depth: Depth, small: Picture, rgb: Picture) -> Depth:
    """Bilinear, and guided where neighbours differ by more than 10 %."""
    window = np.ones((2, 2), np.uint8)
    edge = cv2.dilate(depth, window) > 1.1 * cv2.erode(depth, window)
    where = np.flatnonzero(resize_nearest(edge.view(np.uint8), rgb.shape[:2]))
    smooth = bilinear(depth, small, rgb)
    smooth.ravel()[where] = _nearest_color(depth, small, rgb, where)
    return smooth


WAYS: dict[str, Way] = {
    "nearest": nearest,
    "bilinear": bilinear,
    "bilinear within surfaces, else nearest": bilinear_within_surfaces,
    "of 2 x 2 the nearest colour": guided,
    "bilinear, at edges the nearest colour": guided_at_edges,
}
AT_FRAME = "(the network at the frame's size)"


def _nearest_color(depth: Depth, small: Picture, rgb: Picture, where: NDArray[np.intp]) -> Depth:
    """Depth of the pixels at the flat indices ``where``."""
    (height, width), (low_height, low_width) = rgb.shape[:2], depth.shape
    row, column = np.divmod(where, width)
    top = np.floor((row + 0.5) * low_height / height - 0.5).astype(int)
    left = np.floor((column + 0.5) * low_width / width - 0.5).astype(int)
    color = rgb.reshape(-1, 3)[where].astype(np.int16)
    best = np.full(len(where), np.iinfo(np.int16).max, np.int16)
    chosen = np.zeros(len(where), np.float32)
    for down in (0, 1):
        for right in (0, 1):
            y = np.clip(top + down, 0, low_height - 1)
            x = np.clip(left + right, 0, low_width - 1)
            distance = np.abs(color - small[y, x]).sum(axis=1, dtype=np.int16)
            nearer = distance < best
            best[nearer] = distance[nearer]
            chosen[nearer] = depth[y[nearer], x[nearer]]
    return chosen


class _Score:
    def __init__(self) -> None:
        self.error = self.edge_error = self.pixels = self.edge_pixels = self.air = 0.0
        self.times_ms: list[float] = []

    def add(self, depth: Depth, truth: Depth, time_ms: float) -> None:
        known = (truth > 0) & (truth <= MAX_DEPTH_M)
        window = np.ones((EDGE_WINDOW, EDGE_WINDOW), np.uint8)
        far = cv2.dilate(truth, window)
        near = cv2.erode(np.where(truth > 0, truth, np.float32(1e6)), window)
        edge = known & (far > EDGE_RATIO * near)
        error = np.abs(depth - truth)
        self.error += error[known].sum()
        self.pixels += known.sum()
        self.edge_error += error[edge].sum()
        self.edge_pixels += edge.sum()
        in_air = (depth > (1 + AIR_SHARE) * near) & (depth < far / (1 + AIR_SHARE))
        self.air += (in_air & edge).sum()
        self.times_ms.append(time_ms)

    def cells(self) -> str:
        return (
            f"{1e3 * self.error / self.pixels:.0f} | {1e3 * self.edge_error / self.edge_pixels:.0f}"
            f" | {100 * self.air / self.edge_pixels:.1f} | {np.median(self.times_ms):.1f}"
        )


def main() -> None:
    """Print a table a case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder kitti_streets")
    parser.add_argument("--every", type=int, default=4, help="take every so many frames")
    parser.add_argument("--model", help="bundled model or ONNX file; ssdnet-lite by default")
    parser.add_argument("--threads", type=int, default=2, help="of the network")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    source = KittiStreets(arguments.data)
    samples = range(0, len(source), arguments.every)
    print(f"{cpu_name()}; {len(samples)} frames\n")
    print("| case | way back | MAE [mm] | at edges | in the air, % of edges | ms |\n|" + "---|" * 6)
    with Predictor(arguments.model, size="frame", threads=arguments.threads) as predictor:
        for factor, rows in CASES:
            scores = {name: _Score() for name in (*WAYS, AT_FRAME)}
            for index in samples:
                _score_frame(predictor, source[index], factor, rows, scores)
            height = source[0].size[0] * factor
            title = f"{height} rows" + (f" (enlarged x{factor})" if factor > 1 else "")
            for name, score in scores.items():
                print(f"| {title}, network at {rows} | {name} | {score.cells()} |", flush=True)


def _score_frame(
    predictor: Predictor, sample: Sample, factor: int, rows: int, scores: dict[str, _Score]
) -> None:
    """Score every way on one frame; an enlarged one at the middles of its pixels."""
    frame = resize(sample, (sample.size[0] * factor, sample.size[1] * factor))
    small = resize(frame, (rows, round(frame.size[1] * rows / frame.size[0])))
    depth = predictor.predict(
        small.rgb, small.sparse_depth, focal_length_px=small.focal_length_px
    ).depth
    middles = np.s_[factor // 2 :: factor, factor // 2 :: factor]
    for name, way in WAYS.items():
        started = time.perf_counter()
        back = way(depth, small.rgb, frame.rgb)
        time_ms = (time.perf_counter() - started) * 1e3
        scores[name].add(back[middles], sample.depth, time_ms)
    whole = predictor.predict(frame.rgb, frame.sparse_depth, focal_length_px=frame.focal_length_px)
    scores[AT_FRAME].add(whole.depth[middles], sample.depth, whole.latency.inference_ms)


if __name__ == "__main__":
    main()
