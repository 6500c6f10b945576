"""How much the depth changes when the image is cut by a few columns.

    python benchmarks/stability.py MODEL [MODEL ...] --data DIR [--flicker]

MODEL is a bundled name, an exported file or a checkpoint with semantic and depth. In the validation
frames of DIR/kitti_streets, with all 64 lines and at the frames' own size, 1 to 8 columns are cut
off the left of image and depth map. The program prints the share of pixels whose depth changes by
more than 5 %. Only pixels farther than 6 px from a return are counted, without sky and without the
left 32 columns of the cut frame.

--flicker: in DIR/kitti_drive_0009, with 32 lines, each answer is moved by the poses into the next
frame and compared with its answer where optical flow leads (DIS; where forward and backward flow
agree to 1 px), alone and with memory. The program prints median and 90th percentile of |log ratio|.
"""

import argparse
from collections.abc import Iterable
from itertools import islice, pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from motion import STEP_NS, DriveFrame, recorded_drive
from runtime import Predictor, ScanMemory
from runtime.contract.contract import find_sky
from runtime.engine.bundled_models import find_model
from runtime.streams.memory import relative
from training.datasets.class_mapping import list_classes
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.sample import Sample
from training.datasets.scan_lines import scan_line_of
from training.evaluation.open_model import open_scored_model
from training.loading.open_dataset import open_dataset
from training.scores.evaluated_set import short_names
from training.scores.metrics import distance_px
from training.scores.scoring import Predict

STREETS = KittiStreetsRecipe(path="kitti_streets", first=70, last=98)
CUT_COLUMNS = (1, 2, 3, 5, 8)
SKIPPED_COLUMNS = 32
NEAR_RETURN_PX = 6
CHANGE = 0.05


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", metavar="MODEL")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--flicker", action="store_true")
    parser.add_argument("--limit", type=int, default=51, help="frames of --flicker")
    arguments = parser.parse_args()
    if arguments.flicker:
        frames = list(islice(recorded_drive(arguments.data), arguments.limit))
        print("| model | way | median % | 90th percentile % |\n|---|---|---|---|")
        for model in arguments.models:
            with Predictor(model, threads=arguments.threads, size="frame") as predictor:
                for way, ratios in flicker(predictor, frames).items():
                    figures = " | ".join(f"{100 * np.percentile(ratios, p):.2f}" for p in (50, 90))
                    print(f"| {model} | {way} | {figures} |", flush=True)
        return
    source = open_dataset(STREETS, [arguments.data], classes="camvid")
    paths = [Path(name) if name.endswith(".pt") else find_model(name) for name in arguments.models]
    print("| model | changed depth % |\n|---|---|")
    for title, path in zip(short_names(paths), paths, strict=True):
        with open_scored_model(path, threads=arguments.threads, size="frame") as model:
            frames = (source[index] for index in range(len(source)))
            changed = changed_share(model.predict, frames, sky=find_sky(list_classes(model.table)))
            print(f"| {title} | {100 * changed:.1f} |", flush=True)


def changed_share(predict: Predict, frames: Iterable[Sample], *, sky: int | None) -> float:
    """Return the share of the compared pixels whose depth changes, see the module's docstring."""
    changed = compared = 0
    for frame in frames:
        assert frame.returns is not None
        whole = predict(frame.rgb, frame.returns, frame.focal_length_px)
        assert whole.depth is not None
        counted = distance_px(frame.returns > 0) > NEAR_RETURN_PX
        if sky is not None:
            counted &= whole.semantic != sky
        for columns in CUT_COLUMNS:
            cut = predict(
                np.ascontiguousarray(frame.rgb[:, columns:]),
                np.ascontiguousarray(frame.returns[:, columns:]),
                frame.focal_length_px,
            )
            assert cut.depth is not None
            before, after = np.s_[:, columns + SKIPPED_COLUMNS :], np.s_[:, SKIPPED_COLUMNS:]
            ratio = cut.depth[after] / whole.depth[before]
            changed += np.count_nonzero(np.abs(ratio - 1)[counted[before]] > CHANGE)
            compared += np.count_nonzero(counted[before])
    return changed / compared


def flicker(predictor: Predictor, frames: list[DriveFrame]) -> dict[str, NDArray[np.float64]]:
    """Return |log ratio| of successive answers, alone and with memory, see the docstring above."""
    memory, answers = ScanMemory(), dict[str, list[NDArray[np.float32]]](alone=[], memory=[])
    for number, frame in enumerate(frames):
        fed = frame.points[scan_line_of(frame.points) % 2 == 0]
        present = frame.calibration.project(fed, frame.rgb.shape[:2])
        found = memory.recall(present, frame.pose, number * STEP_NS, frame.calibration)
        both = np.where(found.returns > 0, found.returns, present)
        for way, depth in (("alone", present), ("memory", both)):
            focal_px = frame.calibration.focal_length_px
            prediction = predictor.predict(frame.rgb, depth, focal_length_px=focal_px)
            answers[way].append(prediction.depth)
        memory.answered(prediction)
    ratios: dict[str, list[NDArray[np.float64]]] = {way: [] for way in answers}
    for number, (before, after) in enumerate(pairwise(frames)):
        row, column, to_row, to_column = consistent_flow(before.rgb, after.rgb)
        calibration = before.calibration
        camera = np.linalg.inv(calibration.extrinsics)
        move = relative(before.pose @ camera, after.pose @ camera)
        rays = np.linalg.inv(calibration.intrinsics) @ [column, row, np.ones(len(row))]
        for way, depths in answers.items():
            moved = move[2, :3] @ (rays * depths[number][row, column]) + move[2, 3]
            ratio = depths[number + 1][to_row, to_column] / np.maximum(moved, 0.1)
            ratios[way].append(np.abs(np.log(ratio)))
    return {way: np.concatenate(each) for way, each in ratios.items()}


def consistent_flow(
    before: NDArray[np.uint8], after: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], ...]:
    """Return row and column in both images of the pixels whose flow leads back to them."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (before, after)]
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    forward, backward = dis.calc(*grey, None), dis.calc(*grey[::-1], None)
    height, width = grey[0].shape
    row, column = (axis.ravel() for axis in np.mgrid[:height, :width])
    to_column, to_row = np.rint(forward.reshape(-1, 2).T + np.stack([column, row])).astype(int)
    inside = (to_row >= 0) & (to_row < height) & (to_column >= 0) & (to_column < width)
    row, column, to_row, to_column = (a[inside] for a in (row, column, to_row, to_column))
    off = forward[row, column] + backward[to_row, to_column]
    same = np.hypot(*off.T) < 1
    return row[same], column[same], to_row[same], to_column[same]


if __name__ == "__main__":
    main()
