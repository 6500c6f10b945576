"""Returns of an older scan in a picture of a moving car, left as they are and moved by poses.

    python benchmarks/motion.py drops [--data DIR] [--limit 51]
    python benchmarks/motion.py picture --out FILE.jpg

`drops` leaves out every second scan of a drive. The depth of those frames is predicted from the
camera alone (a), with the scan before as it is (b) or moved by the poses (c), and with the frame's
own scan (d). 32 of the 64 lines are fed, and the other lines of the own scan are scored. With
--data the drive is DIR/kitti_drive_0009; its poses were made from all of its scans, moved to the
time of the frame's own scan. Otherwise it is a rendered street with exact poses, scored on its
dense depth. "moving" are segments of cars whose returns, moved by the poses, are more than 0.3 m
off the frame's own.

`picture` draws a rendered frame with the returns of the scan before, as they are and moved.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from math import nan
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import Predictor
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import compensate_points
from runtime.geometry.poses import PoseTrack
from runtime.recordings.images import read_rgb
from runtime.recordings.poses import read_kitti_poses
from runtime.recordings.scan import read_scan
from training.datasets.scan_lines import project_lines, scan_line_of
from training.lidar.split import OcclusionFilter
from training.scenes.scene_job import SceneClass, SceneJob, Variant, render_frames
from training.scores.metrics import ErrorSums

STEP_NS = 100_000_000
WAYS = {"a": "camera alone", "b": "scan before, as it is", "c": "moved by poses", "d": "its own"}
MOVING_M, NEAR_PX, LEAST_RETURNS = 0.3, 6, 20
REGIONS = ("whole", "still", "moving")
CARS = (13, 14, 15, 16)  # car, truck, bus, train in Cityscapes' training ids
RENDERED_SIZE, SEED = (375, 1242), 3


@dataclass(frozen=True, eq=False)
class DriveFrame:
    """A frame of a drive.

    Attributes:
        rgb: uint8 (H, W, 3).
        points: the scan, float32 (N, 4).
        target: the depth that is scored, float32 (H, W) [m], 0 = none.
        unfiltered: the same, also where the camera cannot see it.
        cars: bool (H, W).
        pose: pose of the LiDAR, (4, 4).
        calibration: calibration of both sensors.
    """

    rgb: NDArray[np.uint8]
    points: NDArray[np.float32]
    target: NDArray[np.float32]
    unfiltered: NDArray[np.float32]
    cars: NDArray[np.bool_]
    pose: NDArray[np.float64]
    calibration: Calibration


def recorded_drive(data: Path) -> Iterator[DriveFrame]:
    """Yield frames of KITTI's drive 0009; the target is every second scan line."""
    drive = data / "kitti_drive_0009"
    calibration = Calibration.from_kitti(drive)
    poses = read_kitti_poses(drive / "poses.txt")
    for index, path in enumerate(sorted((drive / "image_02").glob("*.jpg"))):
        points = read_scan(drive / "velodyne_fov" / f"{path.stem}.bin")
        rgb = read_rgb(path)
        size = rgb.shape[:2]
        whole, line = project_lines(points, calibration.intrinsics, calibration.extrinsics, size)
        unfiltered = np.where(line % 2 == 1, whole, np.float32(0))
        target = OcclusionFilter().apply(unfiltered, whole)
        classes = cv2.imread(
            str(drive / "pseudo_semantic" / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED
        )
        cars = np.isin(classes, CARS)
        yield DriveFrame(rgb, points, target, unfiltered, cars, poses[index], calibration)


def rendered_drive(frames: int, seed: int = SEED) -> Iterator[DriveFrame]:
    """Yield frames of a rendered street with traffic; the target is dense."""
    job = SceneJob(seed, Variant.clone, frames, STEP_NS / 1e9, RENDERED_SIZE)
    for frame in render_frames(job):
        world_from_camera = np.linalg.inv(frame.world_to_camera.astype(np.float64))
        to_camera = frame.scan.to_camera
        calibration = Calibration(frame.intrinsics.astype(np.float64), to_camera)
        cars = frame.label == SceneClass.CAR
        target = np.where(frame.depth < 80, frame.depth, 0).astype(np.float32)
        pose = world_from_camera @ to_camera
        pose[3] = (0, 0, 0, 1)
        yield DriveFrame(frame.rgb, frame.scan.points, target, target, cars, pose, calibration)


def moving_cars(frame: DriveFrame, before: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return car segments in which the scan `before`, moved by poses, is off the frame's own."""
    size = frame.rgb.shape[:2]
    own = frame.calibration.project(frame.points, size)
    moved = frame.calibration.project(before, size)
    count, segments = cv2.connectedComponents(frame.cars.astype(np.uint8))
    found = np.zeros(size, bool)
    for number in range(1, count):
        segment = segments == number
        rows, columns = np.nonzero(segment & (own > 0))
        others = np.stack(np.nonzero(segment & (moved > 0)), axis=1)
        if len(rows) < LEAST_RETURNS or len(others) < LEAST_RETURNS:
            continue
        gaps = np.hypot(rows[:, None] - others[None, :, 0], columns[:, None] - others[None, :, 1])
        nearest = others[gaps.argmin(axis=1)]
        near = gaps.min(axis=1) <= NEAR_PX
        if near.sum() >= LEAST_RETURNS:
            steps = moved[nearest[near, 0], nearest[near, 1]] - own[rows[near], columns[near]]
            found |= segment if abs(np.median(steps)) > MOVING_M else False
    return found


def score_drops(frames: list[DriveFrame], predictor: Predictor) -> dict[str, dict[str, ErrorSums]]:
    """Return the errors of each way to predict every second frame, in each of `REGIONS`."""
    track = PoseTrack.of(
        [frame.pose for frame in frames], [n * STEP_NS for n in range(len(frames))]
    )
    errors = {way: {region: ErrorSums() for region in REGIONS} for way in WAYS}
    for number in range(1, len(frames), 2):
        frame, before = frames[number], frames[number - 1].points
        moved = compensate_points(before, (number - 1) * STEP_NS, track, number * STEP_NS)
        moving = moving_cars(frame, moved)
        is_fed = scan_line_of(before) % 2 == 0
        fed = {
            "a": before[:0],
            "b": before[is_fed],
            "c": moved[is_fed],
            "d": frame.points[scan_line_of(frame.points) % 2 == 0],
        }
        calibration, known = frame.calibration, frame.target > 0
        for way, points in fed.items():
            sparse_depth = calibration.project(points, frame.rgb.shape[:2])
            focal_length_px = calibration.focal_length_px
            answer = predictor.predict(frame.rgb, sparse_depth, focal_length_px=focal_length_px)
            error = (answer.depth - frame.target).astype(np.float64)
            for region, pixels in zip(
                REGIONS, (known, known & ~moving, known & moving), strict=True
            ):
                errors[way][region].add(error[pixels])
    return errors


def draw_returns(frames: list[DriveFrame]) -> NDArray[np.uint8]:
    """Draw the last frame twice, with the returns of the scan before, as they are and moved."""
    *_, before, frame = frames
    track = PoseTrack.of([before.pose, frame.pose], [0, STEP_NS])
    panels = []
    for name, points in (
        ("scan before, as it is", before.points),
        ("moved by poses", compensate_points(before.points, 0, track, STEP_NS)),
    ):
        depth = frame.calibration.project(points, frame.rgb.shape[:2])
        panels.append(draw_points(frame.rgb, depth, name))
    return np.concatenate(panels)


def draw_points(rgb: NDArray[np.uint8], depth: NDArray[np.float32], name: str) -> NDArray[np.uint8]:
    """Draw returns, float32 (H, W), on a darker picture with a title."""
    panel = cv2.addWeighted(rgb, 0.7, np.zeros_like(rgb), 0.3, 0)
    near = 255 - np.clip(255 * np.log2(np.maximum(depth, 3) / 3) / 4.3, 0, 255).astype(np.uint8)
    colors = cv2.cvtColor(cv2.applyColorMap(near, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    for row, column in np.argwhere(depth > 0):
        cv2.circle(panel, (int(column), int(row)), 1, colors[row, column].tolist(), -1)
    cv2.putText(panel, name, (12, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2)
    return np.asarray(panel, np.uint8)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["drops", "picture"])
    parser.add_argument("--out", type=Path, help="of the picture")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--limit", type=int, default=51, help="frames of the drive")
    arguments = parser.parse_args()
    if arguments.part == "picture":
        picture = cv2.cvtColor(draw_returns(list(rendered_drive(6))), cv2.COLOR_RGB2BGR)
        if not cv2.imwrite(str(arguments.out), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]):
            raise OSError(f"cannot write {arguments.out}")
        return
    if arguments.data is None:
        drive = rendered_drive(arguments.limit)
    else:
        drive = recorded_drive(arguments.data)
    frames = list(islice(drive, arguments.limit))
    with Predictor("ssdnet-lite", threads=1, size="frame") as predictor:
        errors = score_drops(frames, predictor)
    print("| returns | " + " | ".join(f"{region} MAE | RMSE" for region in REGIONS) + " |")
    print("|---" * 7 + "|")
    for way, regions in errors.items():
        found = [{"mae_m": nan, "rmse_m": nan, **sums.figures("m")} for sums in regions.values()]
        cells = " | ".join(f"{each['mae_m']:.3f} | {each['rmse_m']:.3f}" for each in found)
        print(f"| ({way}) {WAYS[way]} | {cells} |")
    counts = {region: int(sums.sums[0]) for region, sums in errors["d"].items()}
    print(f"\n{len(frames) // 2} frames without their scan; scored pixels: {counts}")


if __name__ == "__main__":
    main()
