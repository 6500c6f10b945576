"""Earlier returns as further input: what a stream that remembers gains, by lines and poses.

    python benchmarks/memory.py gain DIR [--models ssdnet-lite ...] [--limit 31]
    python benchmarks/memory.py poses DIR [--models ssdnet-lite ...] [--limit 31]
    python benchmarks/memory.py cost
    python benchmarks/memory.py picture --out FILE.jpg

DIR holds kitti_drive_0009. Every second, fourth or eighth of its 64 lines is fed, and the odd lines
are scored. Its poses were made from all lines; "own odometry" are poses made from the fed lines
alone by kiss-icp (extra odometry). Rendered drives (SEEDS) have traffic, exact poses and dense
truth. Every so many frames are scored, all are remembered. MAE / RMSE, median of the absolute
errors in mm: of the visible truth, of its edges (where the truth around differs by EDGE), of cars,
trucks, buses and trains, and of the truth without the filter that removes what the camera cannot
see.

`poses` spoils the poses of the drive with 32 lines. `cost` is the time of the thread for a frame of
64 lines, beside that of the projection of its scan, interleaved.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice, product
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from motion import DriveFrame, draw_points, recorded_drive, rendered_drive
from runtime import Odometry, Predictor, ScanMemory
from runtime.app.run.pipeline import dedicate_process
from runtime.geometry.poses import PoseTrack
from training.datasets.scan_lines import scan_line_of

SEEDS, RENDERED_FRAMES = (3, 7), 14
# Frames are scored from FIRST on, every so many.
FIRST, EVERY, EVERY_RENDERED = 4, 4, 3
STEP_NS, EDGE = 100_000_000, 1.3
REGIONS = ("visible", "edges", "cars", "unfiltered")
Poses = NDArray[np.float64]


def _turned(degrees_a_s: float, poses: Poses) -> Poses:
    """Poses that drift in yaw."""
    found = poses.copy()
    for number, pose in enumerate(found):
        angle = np.deg2rad(degrees_a_s * number * STEP_NS / 1e9)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        pose[:2, :2] = poses[number, :2, :2] @ turn  # the LiDAR looks along x, z is up
        pose[2, :2] = poses[number, 2, :2] @ turn
    return found


def _stretched(percent: float, poses: Poses) -> Poses:
    """Poses with a wrong scale of the way."""
    found = poses.copy()
    found[:, :3, 3] *= 1 + percent / 100
    return found


def _delayed(late_ms: float, poses: Poses) -> Poses:
    """Poses that were true some time before."""
    stamps = np.arange(len(poses), dtype=np.int64) * STEP_NS
    return PoseTrack.of(poses, stamps).at(np.maximum(stamps - round(late_ms * 1e6), 0))


# Name -> poses (N, 4, 4) with this error, of the right ones.
SPOILED: dict[str, Callable[[Poses], Poses]] = {
    "right": lambda poses: poses,
    **{f"{rate} degrees a second": partial(_turned, rate) for rate in (0.1, 0.3, 1, 3)},
    **{f"{share} % of the way": partial(_stretched, share) for share in (1, 3, 10)},
    **{f"{late} ms late": partial(_delayed, late) for late in (10, 50, 100)},
}


class Sums(NamedTuple):
    """Errors by way and region."""

    errors: dict[tuple[str, str], list[NDArray[np.float32]]]

    def add(self, way: str, depth: NDArray[np.float32], frame: DriveFrame) -> None:
        known = frame.target > 0
        masks = (known, known & edges(frame), known & frame.cars, frame.unfiltered > 0)
        truths = (frame.target,) * 3 + (frame.unfiltered,)
        for region, mask, truth in zip(REGIONS, masks, truths, strict=True):
            self.errors.setdefault((way, region), []).append((depth - truth)[mask])

    def cells(self, way: str) -> str:
        found = [np.concatenate(self.errors[way, region]) for region in REGIONS]
        figures = ((np.abs(e).mean(), np.sqrt(np.square(e, dtype=float).mean()), e) for e in found)
        return " | ".join(
            f"{1e3 * mae:.0f} / {1e3 * rmse:.0f}, {1e3 * np.median(np.abs(e)):.0f}"
            for mae, rmse, e in figures
        )


def edges(frame: DriveFrame) -> NDArray[np.bool_]:
    """Where the truth around a pixel differs by EDGE, in a window that bridges two lines."""
    dense = np.count_nonzero(frame.target) > frame.target.size / 4
    kernel = np.ones((5, 5) if dense else (15, 9), np.uint8)
    nearest = cv2.erode(np.where(frame.unfiltered > 0, frame.unfiltered, np.float32(1e6)), kernel)
    return np.asarray(cv2.dilate(frame.unfiltered, kernel) > EDGE * nearest)


def fed_points(frame: DriveFrame, lines: int) -> NDArray[np.float32]:
    """The points of every so many-th line."""
    return frame.points[scan_line_of(frame.points) % (64 // lines) == 0]


def score(
    frames: Sequence[DriveFrame], poses: Poses, lines: int, predictor: Predictor, every: int
) -> tuple[Sums, int, float]:
    """Return the errors alone and with memory, the frames in which it was off, and its returns."""
    sums, memory, off, returned = Sums({}), ScanMemory(), 0, []
    for number, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
        present = frame.calibration.project(fed_points(frame, lines), frame.rgb.shape[:2])
        found = memory.recall(present, pose, number * STEP_NS, frame.calibration)
        off += bool(found.off)
        focal_px = frame.calibration.focal_length_px
        more = np.where(found.returns > 0, found.returns, present)
        answer = predictor.predict(frame.rgb, more, focal_length_px=focal_px)
        memory.answered(answer)
        if number >= FIRST and (number - FIRST) % every == 0:
            alone = predictor.predict(frame.rgb, present, focal_length_px=focal_px)
            returned.append(found.returned / np.count_nonzero(present))
            for way, prediction in (("alone", alone), ("memory", answer)):
                sums.add(way, prediction.depth, frame)
    return sums, off, float(np.mean(returned))


def drive_poses(frames: Sequence[DriveFrame], lines: int) -> Poses:
    """Poses by odometry from the fed lines."""
    odometry = Odometry()
    return np.stack([odometry.add(fed_points(frame, lines)) for frame in frames])


def print_gain(data: Path, models: Sequence[str], limit: int) -> None:
    """Print the table by set, lines and model."""
    print(f"| frames | lines | model | way | {' | '.join(REGIONS)} |\n{'|---' * 8}|")
    drive = list(islice(recorded_drive(data), limit))
    sets = {"drive 0009": (drive, (32, 16, 8)), "drive 0009, own odometry": (drive, (32, 16, 8))}
    for seed in SEEDS:
        rendered = list(rendered_drive(RENDERED_FRAMES, seed))
        sets[f"rendered, seed {seed}"] = (rendered, (64, 32, 16))
    for title, (frames, all_lines) in sets.items():
        for lines, model in product(all_lines, models):
            poses = np.stack([frame.pose for frame in frames])
            if title.endswith("odometry"):
                poses = drive_poses(frames, lines)
            every = EVERY if frames is drive else EVERY_RENDERED
            with Predictor(model, threads=1, size="frame") as predictor:
                sums, _, more = score(frames, poses, lines, predictor, every)
            for way, name in (("alone", "alone"), ("memory", f"{1 + more:.1f} x the returns")):
                cells = title, lines, model, name, sums.cells(way)
                print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_poses(data: Path, models: Sequence[str], limit: int) -> None:
    """Print the table by error of the poses."""
    frames = list(islice(recorded_drive(data), limit))
    right = drive_poses(frames, 32)
    print(f"| poses | model | off in frames | {' | '.join(REGIONS)} |\n{'|---' * 7}|")
    for model in models:
        with Predictor(model, threads=1, size="frame") as predictor:
            for title, spoil in SPOILED.items():
                sums, off, _ = score(frames, spoil(right), 32, predictor, EVERY)
                if title == "right":
                    print(f"| alone | {model} | | {sums.cells('alone')} |")
                print(f"| {title} | {model} | {off} | {sums.cells('memory')} |", flush=True)


def print_cost(rounds: int) -> None:
    """Print the time of a thread for a frame with five scans, beside its projection."""
    dedicate_process()
    frames = list(rendered_drive(8, SEEDS[0]))
    times_ms: dict[str, list[float]] = {"projection of its scan": [], "memory, five scans": []}
    for _ in range(rounds):
        memory, size = ScanMemory(0.55), frames[0].rgb.shape[:2]
        for number, frame in enumerate(frames):
            started = time.thread_time()
            present = frame.calibration.project(frame.points, size)
            projected = time.thread_time()
            found = memory.recall(present, frame.pose, number * STEP_NS, frame.calibration)
            done = time.thread_time()
        for name, span in zip(times_ms, (projected - started, done - projected), strict=True):
            times_ms[name].append(1e3 * span)
    print(f"{np.count_nonzero(present)} returns, {found.returned} remembered, n = {rounds}\n")
    print("| step | median ms | p99 ms |\n|---|---|---|")
    for name, times in times_ms.items():
        print("| {} | {:.2f} | {:.2f} |".format(name, *np.percentile(times, [50, 99])))


def draw(frames: int) -> NDArray[np.uint8]:
    """Draw present and remembered returns of a rendered frame, and its answers and their errors."""
    memory, drive = ScanMemory(), list(rendered_drive(frames, SEEDS[0]))
    with Predictor("ssdnet-lite", threads=1, size="frame") as predictor:
        for number, frame in enumerate(drive):
            size, focal_px = frame.rgb.shape[:2], frame.calibration.focal_length_px
            present = frame.calibration.project(fed_points(frame, 16), size)
            further = memory.recall(
                present, frame.pose, number * STEP_NS, frame.calibration
            ).returns
            fed = {"alone": present, "with memory": np.where(further > 0, further, present)}
            answers = {
                name: predictor.predict(frame.rgb, depth, focal_length_px=focal_px)
                for name, depth in fed.items()
            }
            memory.answered(answers["with memory"])
    panels = [
        draw_points(frame.rgb, present, "present returns of 16 lines"),
        draw_points(frame.rgb, further, "remembered returns of the scans before"),
    ]
    for name, answer in answers.items():
        off = np.abs(answer.depth - frame.target) / np.maximum(frame.target, 1)
        shown = np.where(frame.target > 0, np.clip(255 * off / 0.2, 0, 255), 0).astype(np.uint8)
        panel = cv2.cvtColor(cv2.applyColorMap(shown, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
        text = f"error of the depth {name}, black 0, yellow 20 %"
        cv2.putText(panel, text, (12, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2)
        panels.append(panel)
    return np.concatenate(panels)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["gain", "poses", "cost", "picture"])
    parser.add_argument("data", type=Path, nargs="?", help="of gain and poses")
    parser.add_argument("--models", nargs="+", default=["ssdnet-lite", "ssdnet-nano"])
    parser.add_argument("--limit", type=int, default=31, help="frames of the drive")
    parser.add_argument("--rounds", type=int, default=50, help="of cost")
    parser.add_argument("--out", type=Path, help="of the picture")
    arguments = parser.parse_args()
    if arguments.part == "cost":
        print_cost(arguments.rounds)
    elif arguments.part == "picture":
        picture = cv2.cvtColor(draw(8), cv2.COLOR_RGB2BGR)
        picture = cv2.resize(picture, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        if not cv2.imwrite(str(arguments.out), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]):
            raise OSError(f"cannot write {arguments.out}")
    else:
        report = print_gain if arguments.part == "gain" else print_poses
        report(arguments.data, arguments.models, arguments.limit)


if __name__ == "__main__":
    main()
