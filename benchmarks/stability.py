"""How far answers change with what should hardly change them.

    python benchmarks/stability.py MODEL [MODEL ...] --data DIR [--limit N]

MODEL is a bundled name, an exported file or a checkpoint with semantic and depth. All 64 lines are
fed, at the frames' own size. On the validation frames of DIR/kitti_streets:

- shift: 1 to 8 columns are cut off the left of image and depth map. Share of the pixels farther
  than 6 px from a return, without sky, whose depth changes by more than 5 %, and share of all
  pixels that change class. The left 32 columns of the cut frame are not counted.
- lidar: share of the pixels that change class without the LiDAR.
- false: 12 false returns of 3 m, at most 6 px from a return and where the answer is over 12 m.
  Pixels whose depth changes by more than 10 %, per false return.
- seam: jump of the log depth across the scan's upper edge beyond that of the answer without LiDAR,
  or against it; mean of the columns whose class does not change there and is not sky.
- border: share of the first 6 rows that is not sky, of the columns with sky below them.

On consecutive frames of DIR/kitti_drive_0009, 30 to 50:

- flicker: pixels are followed by optical flow. 90th percentile of |log ratio of their depth and the
  depth expected, nearer by the median step|, the mean over pairs, and share of them that changes
  class. A car that drives on comes nearer to all things alike.

On DIR/camvid, whose frames have no LiDAR:

- pseudo-LiDAR: mIoU from the camera alone, and with 64 lines simulated on the depth of that answer.
"""

import argparse
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.bundled_models import find_model
from runtime.contract import find_sky
from runtime.errors import InputError
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.sample import Sample, SampleSource, nothing_known
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.depth_regions import distance_px
from training.evaluation.evaluate import short_names
from training.evaluation.metrics import SemanticScores
from training.evaluation.scored_model import ScoredModel, open_model
from training.evaluation.scoring import HeadMaps, Predict
from training.lidar.split import SENSOR_LINES, frame_generator, scan_lines
from training.loading.open_dataset import open_dataset

STREETS = KittiStreetsRecipe(path="kitti_streets", first=70, last=98)
DRIVE = KittiStreamRecipe(path="kitti_drive_0009", first=30, last=50)
CAMVID = CamVidRecipe(path="camvid", split="val")
CUT_COLUMNS = (1, 2, 3, 5, 8)
SKIPPED_COLUMNS = 32
NEAR_RETURN_PX = 6
SHIFT_CHANGE, FALSE_CHANGE = 0.05, 0.10
FALSE_RETURNS, FALSE_M, FALSE_BEYOND_M = 12, 3.0, 12.0
#: Columns over which the scan's upper edge is the highest return, and half the step across it.
EDGE_COLUMNS, SEAM_PX = 17, 8
BORDER_ROWS = 6
FLOW_AGREEMENT_PX = 0.5
FLICKER_PERCENTILE = 90
#: Focal length of the assumed camera, as a share of its width.
PSEUDO_FOCAL = 500 / 480

#: Key, title and factor of the table's columns.
COLUMNS = (
    ("shift_depth", "shift depth %", 100.0),
    ("shift_class", "shift class %", 100.0),
    ("lidar_class", "lidar class %", 100.0),
    ("false_px", "false px", 1.0),
    ("seam", "seam %", 100.0),
    ("border", "border %", 100.0),
    ("flicker_depth", "flicker depth %", 100.0),
    ("flicker_class", "flicker class %", 100.0),
    ("camvid_miou", "CamVid mIoU %", 100.0),
    ("camvid_miou_pseudo_lidar", "with pseudo-LiDAR %", 100.0),
)

Figures = dict[str, float]


class Frame(NamedTuple):
    """The inputs of one answer.

    Attributes:
        rgb: uint8 (H, W, 3).
        sparse_depth: float32 (H, W) [m], 0 = no return.
        focal_length_px: fx, None = unknown.
    """

    rgb: NDArray[np.uint8]
    sparse_depth: NDArray[np.float32]
    focal_length_px: float | None = None


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", metavar="MODEL")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--limit", type=int, help="frames of each set")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()

    def read(recipe: SourceRecipe, *, spread: bool = True) -> list[Sample]:
        source = open_dataset(recipe, [arguments.data], classes="camvid")
        return take(source, arguments.limit, spread=spread)

    streets, drive, camvid = read(STREETS), read(DRIVE, spread=False), read(CAMVID)
    paths = [Path(name) if name.endswith(".pt") else find_model(name) for name in arguments.models]
    rows: dict[str, Figures] = {}
    for title, path in zip(short_names(paths), paths, strict=True):
        with open_model(path, threads=arguments.threads, size="frame") as model:
            rows[title] = run_probes(model, streets, drive, camvid)
    print(format_table(rows))


def take(source: SampleSource, limit: int | None, *, spread: bool) -> list[Sample]:
    """Return at most `limit` frames: evenly spread over the set, or the first ones."""
    count = len(source) if limit is None else min(limit, len(source))
    last = len(source) - 1 if spread else count - 1
    return [source[int(index)] for index in np.linspace(0, last, count).round()]


def run_probes(
    model: ScoredModel,
    streets: Sequence[Sample],
    drive: Sequence[Sample],
    camvid: Sequence[Sample],
) -> Figures:
    """Return the figures of all probes, without those that no pixel was measured for.

    Pseudo-LiDAR is for models of CamVid's classes alone. Raises InputError for a model without
    semantic or depth.
    """
    predict, sky = model.predict, find_sky(model.classes)
    frames = [Frame(item.rgb, item.sparse_depth, item.focal_length_px) for item in streets]
    if not {"semantic", "depth"} <= predict(*frames[0]).heads.keys():
        raise InputError("the probes need a model with semantic and depth: choose another")
    figures = probe_shift(predict, frames, sky=sky)
    figures |= probe_lidar(predict, frames)
    figures |= probe_false_returns(predict, frames)
    figures |= probe_seam(predict, frames, sky=sky)
    figures |= probe_border(predict, frames, sky=sky)
    consecutive = (Frame(item.rgb, item.depth, item.focal_length_px) for item in drive)
    figures |= probe_flicker(predict, consecutive)
    if model.table == "camvid":
        labelled = [(item.rgb, item.semantic) for item in camvid]
        figures |= probe_pseudo_lidar(predict, labelled, sky=sky, num_classes=len(model.classes))
    return {key: value for key, value in figures.items() if not math.isnan(value)}


def probe_shift(predict: Predict, frames: Iterable[Frame], *, sky: int | None) -> Figures:
    """Return what cutting columns off the left of the frames changes, see the file's top."""
    depths, classes = np.zeros(2), np.zeros(2)  # changed pixels, compared pixels
    for frame in frames:
        whole = predict(*frame)
        counted = distance_px(frame.sparse_depth > 0) > NEAR_RETURN_PX
        if sky is not None:
            counted &= whole.semantic != sky
        for columns in CUT_COLUMNS:
            cut = predict(
                np.ascontiguousarray(frame.rgb[:, columns:]),
                np.ascontiguousarray(frame.sparse_depth[:, columns:]),
                frame.focal_length_px,
            )
            before, after = np.s_[:, columns + SKIPPED_COLUMNS :], np.s_[:, SKIPPED_COLUMNS:]
            changed = relative_change(whole.depth[before], cut.depth[after]) > SHIFT_CHANGE
            depths += tally(changed[counted[before]])
            classes += tally(whole.semantic[before] != cut.semantic[after])
    return {"shift_depth": share(depths), "shift_class": share(classes)}


def probe_lidar(predict: Predict, frames: Iterable[Frame]) -> Figures:
    """Return the share of the pixels that change class without the LiDAR."""
    classes = np.zeros(2)
    for frame in frames:
        alone = predict(*frame._replace(sparse_depth=np.zeros_like(frame.sparse_depth)))
        classes += tally(predict(*frame).semantic != alone.semantic)
    return {"lidar_class": share(classes)}


def probe_false_returns(predict: Predict, frames: Iterable[Frame]) -> Figures:
    """Return the pixels that a false return of `FALSE_M` changes, of `FALSE_RETURNS` at once."""
    changes = np.zeros(2)  # changed pixels, false returns
    for index, frame in enumerate(frames):
        before = predict(*frame).depth
        scanned = distance_px(frame.sparse_depth > 0) <= NEAR_RETURN_PX
        places = np.flatnonzero(scanned & (before > FALSE_BEYOND_M))
        count = min(FALSE_RETURNS, places.size)
        spoiled = frame.sparse_depth.copy()
        spoiled.flat[frame_generator(index).choice(places, count, replace=False)] = FALSE_M
        after = predict(*frame._replace(sparse_depth=spoiled)).depth
        changes += np.count_nonzero(relative_change(before, after) > FALSE_CHANGE), count
    return {"false_px": share(changes)}


def probe_seam(predict: Predict, frames: Iterable[Frame], *, sky: int | None) -> Figures:
    """Return the mean over all frames' columns of `seam_jumps`."""
    jumps = []
    for frame in frames:
        alone = predict(*frame._replace(sparse_depth=np.zeros_like(frame.sparse_depth)))
        jumps.append(seam_jumps(predict(*frame), alone, frame.sparse_depth > 0, sky=sky))
    jump = np.concatenate(jumps)
    seen = jump[~np.isnan(jump)]
    return {"seam": float(seen.mean()) if seen.size else float("nan")}


def seam_jumps(
    answer: HeadMaps, alone: HeadMaps, measured: NDArray[np.bool_], *, sky: int | None
) -> NDArray[np.float32]:
    """Return the seam at each column, float32 (W,); NaN where there is none to see.

    ``alone`` is the answer without LiDAR, ``measured`` bool (H, W), where the scan has a return.
    """
    height, width = measured.shape
    top = np.where(measured.any(axis=0), measured.argmax(axis=0), height).astype(np.float32)
    edge = cv2.erode(top[None], np.ones((1, EDGE_COLUMNS), np.uint8))[0].astype(np.int64)
    columns = np.flatnonzero((edge >= SEAM_PX) & (edge + SEAM_PX < height))
    rows = edge[columns] + np.arange(-SEAM_PX, SEAM_PX + 1)[:, None]
    classes = answer.semantic[rows, columns]
    same = (classes == classes[0]).all(axis=0) & (classes[0] != (-1 if sky is None else sky))
    logs = (np.log(each.depth[rows[[0, -1]], columns]) for each in (answer, alone))
    jump, expected = (log[0] - log[1] for log in logs)
    beyond = jump - jump.clip(np.minimum(expected, 0), np.maximum(expected, 0))
    result = np.full(width, np.nan, np.float32)
    result[columns[same]] = np.abs(beyond)[same]
    return result


def probe_border(predict: Predict, frames: Iterable[Frame], *, sky: int | None) -> Figures:
    """Return the share of the first `BORDER_ROWS` that is not sky, above sky."""
    classes = np.zeros(2)
    for frame in frames:
        is_sky = predict(*frame).semantic == (-1 if sky is None else sky)
        classes += tally(~is_sky[:BORDER_ROWS, is_sky[BORDER_ROWS]])
    return {"border": share(classes)}


def probe_flicker(predict: Predict, frames: Iterable[Frame]) -> Figures:
    """Return what changes between consecutive frames at pixels that optical flow finds again."""
    deviations, classes = [], np.zeros(2)
    answers = ((frame.rgb, predict(*frame)) for frame in frames)
    for (rgb, one), (next_rgb, other) in pairwise(answers):
        there, kept = match_pixels(optical_flow(rgb, next_rgb), optical_flow(next_rgb, rgb))
        if not kept.any():
            continue
        depth = cv2.remap(other.depth, there, None, cv2.INTER_LINEAR)
        semantic = cv2.remap(other.semantic, there, None, cv2.INTER_NEAREST)
        expected = one.depth[kept] - np.median(one.depth[kept] - depth[kept])
        ahead = expected > 0
        ratio = np.log(depth[kept][ahead] / expected[ahead])
        deviations.append(np.percentile(np.abs(ratio), FLICKER_PERCENTILE))
        classes += tally(one.semantic[kept] != semantic[kept])
    mean = float(np.mean(deviations)) if deviations else float("nan")
    return {"flicker_depth": mean, "flicker_class": share(classes)}


def match_pixels(
    forward: NDArray[np.float32], backward: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the place of every pixel in the next frame, and where both flows agree on it."""
    height, width = forward.shape[:2]
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    there = np.stack([columns, rows], axis=-1) + forward
    inside = ((there >= 0) & (there <= (width - 1, height - 1))).all(axis=-1)
    back = cv2.remap(backward, there, None, cv2.INTER_LINEAR)
    return there, inside & (np.linalg.norm(forward + back, axis=-1) <= FLOW_AGREEMENT_PX)


def optical_flow(rgb: NDArray[np.uint8], next_rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the step of each pixel to the next image [px], right and down: float32 (H, W, 2).

    Dense inverse search (Kroeger et al. 2016).
    """
    gray, next_gray = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (rgb, next_rgb))
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(gray, next_gray, None)


def probe_pseudo_lidar(
    predict: Predict,
    frames: Iterable[tuple[NDArray[np.uint8], NDArray[np.uint8]]],
    *,
    sky: int | None,
    num_classes: int,
) -> Figures:
    """Return mIoU of (image, labels) from the camera alone, and with lines of its own depth."""
    alone, scanned = SemanticScores(num_classes), SemanticScores(num_classes)
    for index, (rgb, labels) in enumerate(frames):
        height, width = rgb.shape[:2]
        first = predict(rgb, nothing_known((height, width)), None)
        solid = first.depth if sky is None else np.where(first.semantic == sky, 0, first.depth)
        focal = PSEUDO_FOCAL * width
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        lines = scan_lines(solid, intrinsics, SENSOR_LINES, frame_generator(index))
        alone.update(first.semantic, labels)
        scanned.update(predict(rgb, lines, None).semantic, labels)
    return {
        "camvid_miou": alone.compute().mean_iou,
        "camvid_miou_pseudo_lidar": scanned.compute().mean_iou,
    }


def relative_change(before: NDArray[np.float32], after: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return |after / before - 1| of depths above 0."""
    return np.abs(after / before - 1)


def tally(changed: NDArray[np.bool_]) -> tuple[int, int]:
    """Count the pixels that changed, and all."""
    return np.count_nonzero(changed), changed.size


def share(counts: NDArray[np.float64]) -> float:
    """Return the first count over the second; NaN of nothing."""
    return float(counts[0] / counts[1]) if counts[1] else float("nan")


def format_table(rows: dict[str, Figures]) -> str:
    """Return the Markdown table, a row a model."""
    lines = ["| model | " + " | ".join(title for _, title, _ in COLUMNS) + " |"]
    lines.append("|---|" + "---|" * len(COLUMNS))
    for model, figures in rows.items():
        cells = [
            f"{figures[key] * factor:.2f}" if key in figures else "" for key, _, factor in COLUMNS
        ]
        lines.append(f"| {model} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
