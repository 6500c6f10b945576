"""Returns of an older scan in a picture of a moving car: left as they are, and moved by poses.

    python benchmarks/motion.py drops [--data DIR] [--model ssdnet-lite] [--age 2]
    python benchmarks/motion.py sweep
    python benchmarks/motion.py picture --out FILE.jpg

drops  Every second scan of a drive is dropped. Depth of those frames is predicted from the camera
       alone (a), with the scan before as it is (b), moved by the poses (c), and with the frame's
       own scan (d). --age 2 takes the scan two frames before. 32 of the 64 lines are fed; scored
       are the own scan's other lines. With --data, DIR/kitti_drive_0009, whose poses were made from
       all of its scans, moved to the time of the frame's own scan; without, a rendered
       street, scored on its dense depth, with exact poses. "moving": car segments whose returns,
       moved by the poses, lie more than 0.3 m off the frame's own. "flicker": the 90th percentile
       of `stability.py`, over all frames.
sweep  A scan of 100 ms on a street of planes, straight on at 15 m/s and in a curve of 0.5 rad/s.
       Each column is measured at its own time, in closed form. Error of the returns in the picture
       of the scan's middle, as they are and each moved by its own time; in a picture 50 ms later,
       moved as one, too. Poses at 100 Hz.
picture  A rendered frame with the returns of the scan before, as they are and moved.
"""

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from projection import EXTRINSICS, INTRINSICS
from runtime import Predictor
from runtime.io.calibration import Calibration
from runtime.io.images import read_rgb
from runtime.io.poses import read_kitti_poses
from runtime.io.scan import read_scan
from runtime.projection import OcclusionFilter
from runtime.sync.motion import move_points
from runtime.sync.poses import PoseTrack
from stability import Frame as Followed
from stability import optical_flow, probe_flicker
from training.evaluation.scoring import HeadMaps
from training.lidar.scan import project_lines, scan_line_of
from training.scenes.scene_job import SceneClass, SceneJob, Variant, render_frames

STEP_NS = 100_000_000
WAYS = {"a": "camera alone", "b": "scan before, as it is", "c": "moved by poses", "d": "its own"}
MOVING_M, NEAR_PX, LEAST_RETURNS = 0.3, 6, 20
CARS = (13, 14, 15, 16)  # car, truck, bus, train in Cityscapes' training ids
RENDERED_SIZE = (375, 1242)


@dataclass(frozen=True, eq=False)
class DriveFrame:
    """A frame of a drive.

    rgb: uint8 (H, W, 3). points: float32 (N, 4), the scan. target: float32 (H, W) [m], 0 = none,
    what is scored. cars: bool (H, W). pose: (4, 4) of the LiDAR. calibration: of both sensors.
    """

    rgb: NDArray[np.uint8]
    points: NDArray[np.float32]
    target: NDArray[np.float32]
    cars: NDArray[np.bool_]
    pose: NDArray[np.float64]
    calibration: Calibration


def recorded_drive(data: Path) -> Iterator[DriveFrame]:
    """Frames of KITTI's drive 0009; the target is every second scan line."""
    drive = data / "kitti_drive_0009"
    calibration = Calibration.from_kitti(drive)
    poses = read_kitti_poses(drive / "poses.txt")
    for index, path in enumerate(sorted((drive / "image_02").glob("*.jpg"))):
        points = read_scan(drive / "velodyne_fov" / f"{path.stem}.bin")
        rgb = read_rgb(path)
        size = rgb.shape[:2]
        whole, line = project_lines(points, calibration.intrinsics, calibration.extrinsics, size)
        target = np.where(line % 2 == 1, whole, np.float32(0))
        target = OcclusionFilter().apply(target, whole)
        classes = cv2.imread(
            str(drive / "pseudo_semantic" / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED
        )
        cars = np.isin(classes, CARS)
        yield DriveFrame(rgb, points, target, cars, poses[index], calibration)


def rendered_drive(seed: int, frames: int) -> Iterator[DriveFrame]:
    """Frames of a rendered street with traffic; the target is dense."""
    job = SceneJob(seed, Variant.clone, frames, STEP_NS / 1e9, RENDERED_SIZE)
    for frame in render_frames(job):
        world_from_camera = np.linalg.inv(frame.world_to_camera.astype(np.float64))
        to_camera = frame.scan.to_camera
        calibration = Calibration(frame.intrinsics.astype(np.float64), to_camera)
        cars = frame.label == SceneClass.CAR
        target = np.where(frame.depth < 80, frame.depth, 0).astype(np.float32)
        pose = world_from_camera @ to_camera
        pose[3] = (0, 0, 0, 1)
        yield DriveFrame(frame.rgb, frame.scan.points, target, cars, pose, calibration)


def moving_cars(frame: DriveFrame, before: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Segments of car pixels where the scan `before`, moved by poses, is off the frame's own."""
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


def score_drops(
    frames: list[DriveFrame], predictor: Predictor, *, age: int = 1, lines: int = 32
) -> dict[str, dict[str, float]]:
    """Return the figures of each way to answer the frames of odd number."""
    track = PoseTrack.of(
        [frame.pose for frame in frames], [n * STEP_NS for n in range(len(frames))]
    )
    errors: dict[str, dict[str, list[NDArray[np.float32]]]] = {
        way: defaultdict(list) for way in WAYS
    }
    answers: dict[str, list[HeadMaps]] = {way: [] for way in WAYS}
    for number, frame in enumerate(frames):
        size = frame.rgb.shape[:2]

        def answer(points: NDArray[np.float32] | None, frame: DriveFrame = frame) -> HeadMaps:
            sparse = np.zeros(frame.rgb.shape[:2], np.float32)
            if points is not None:
                sparse = frame.calibration.project(points, frame.rgb.shape[:2])
            focal_length_px = frame.calibration.focal_length_px
            made = predictor.predict(frame.rgb, sparse, focal_length_px=focal_length_px)
            return HeadMaps(made.semantic, made.depth, made.boundary)

        own = answer(frame.points[scan_line_of(frame.points) % (64 // lines) == 0])
        if number % 2 == 0 or number < age:
            for way in WAYS:
                answers[way].append(own)
            continue
        before = frames[number - age].points
        times = (number - age) * STEP_NS
        moved = move_points(before, times, track, number * STEP_NS)
        kept = scan_line_of(before) % (64 // lines) == 0
        answers["a"].append(answer(None))
        answers["b"].append(answer(before[kept]))
        answers["c"].append(answer(moved[kept]))
        answers["d"].append(own)
        moving = moving_cars(frame, moved)
        for way in WAYS:
            depth = answers[way][-1].depth
            error = np.where(frame.target > 0, depth - frame.target, np.nan)
            for name, region in (("whole", True), ("still", ~moving), ("moving", moving)):
                errors[way][name].append(error[np.broadcast_to(region, size) & (frame.target > 0)])
    table = {}
    for way in WAYS:
        row = {}
        for name, parts in errors[way].items():
            values = np.concatenate(parts).astype(np.float64)
            row[f"{name} n"] = float(len(values))
            row[f"{name} MAE"] = float(np.abs(values).mean()) if len(values) else float("nan")
            row[f"{name} RMSE"] = (
                float(np.sqrt((values**2).mean())) if len(values) else float("nan")
            )
        queue = iter(answers[way])
        followed = (Followed(f.rgb, f.target, f.calibration.focal_length_px) for f in frames)
        flicker = probe_flicker(lambda *frame: next(queue), followed, follow=optical_flow)  # noqa: B023
        table[way] = row | flicker
    return table


# --- a scan of 100 ms --------------------------------------------------------------------------

SWEEP_NS, COLUMNS = 100_000_000, 1800
Motion = Callable[[float], NDArray[np.float64]]


def car_pose(time_s: float, *, speed: float, turn: float) -> NDArray[np.float64]:
    """Pose (4, 4) of a LiDAR 1.73 m above the road on a circle; turn [rad/s]."""
    angle = turn * time_s
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    if turn:
        radius = speed / turn
        pose[:2, 3] = radius * np.sin(angle), radius * (1 - np.cos(angle))
    else:
        pose[0, 3] = speed * time_s
    pose[2, 3] = 1.73
    return pose


#: Planes n . x = d of the street: the road, a house on each side, a wall across it.
PLANES = (((0, 0, 1), 0.0), ((0, 1, 0), 7.0), ((0, 1, 0), -5.0), ((0.8, 0.6, 0), 45.0))


def swept_scan(
    pose_at: Motion,
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float64]]:
    """One turn: points (N, 3) as measured, times [ns], and the places hit, in the world (N, 3)."""
    elevation = np.deg2rad(np.concatenate([2 - np.arange(32) / 3, -8.83 - np.arange(32) / 2]))
    points, times, places = [], [], []
    for column in range(COLUMNS):
        time_ns = round(column * SWEEP_NS / COLUMNS)
        # Clockwise from behind, as a Velodyne turns: ahead in the middle of the scan.
        azimuth = np.pi - 2 * np.pi * column / COLUMNS
        local = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            axis=1,
        )
        pose = pose_at(time_ns / 1e9)
        rays = local @ pose[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            ranges = np.stack([(d - pose[:3, 3] @ n) / (rays @ n) for n, d in PLANES])
        distance = np.where(ranges > 0.5, ranges, np.inf).min(axis=0)
        hit = distance < 100
        points.append(local[hit] * distance[hit, None])
        places.append(pose[:3, 3] + rays[hit] * distance[hit, None])
        times.append(np.full(hit.sum(), time_ns, np.int64))
    return np.concatenate(points).astype(np.float32), np.concatenate(times), np.concatenate(places)


def sweep_errors(*, speed: float, turn: float, later_ms: int = 0) -> dict[str, NDArray[np.float64]]:
    """Way -> error of each return that the picture should show: (N, 2), pixels and metres."""

    def pose_at(time_s: float) -> NDArray[np.float64]:
        return car_pose(time_s, speed=speed, turn=turn)

    points, times, places = swept_scan(pose_at)
    middle = SWEEP_NS // 2
    to = middle + later_ms * 1_000_000
    stamps = np.arange(-1, 12) * 10_000_000
    track = PoseTrack.of([pose_at(stamp / 1e9) for stamp in stamps], stamps)
    pose = pose_at(to / 1e9)
    exact = (places - pose[:3, 3]) @ pose[:3, :3]
    seen, exact_z = _pixels(exact)
    ways = {"as they are": points}
    if later_ms:
        ways["as one"] = move_points(points, middle, track, to)
    ways["each by its own time"] = move_points(points, times, track, to)
    errors = {}
    inside = (exact_z > 1) & (np.abs(seen - (620.5, 187)) <= (620.5, 187)).all(axis=1)
    for name, moved in ways.items():
        pixels, z = _pixels(moved.astype(np.float64))
        off_px = np.linalg.norm(pixels - seen, axis=1)
        errors[name] = np.stack([off_px, np.abs(z - exact_z)], axis=1)[inside]
    return errors


def _pixels(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    seen = points @ EXTRINSICS[:3, :3].T + EXTRINSICS[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (seen @ INTRINSICS.T)[:, :2] / seen[:, 2:], seen[:, 2]


def draw_returns(frames: list[DriveFrame]) -> NDArray[np.uint8]:
    """The last frame twice, with the returns of the scan before, as they are and moved."""
    *_, before, frame = frames
    track = PoseTrack.of([before.pose, frame.pose], [0, STEP_NS])
    panels = []
    for name, points in (
        ("scan before, as it is", before.points),
        ("moved by poses", move_points(before.points, 0, track, STEP_NS)),
    ):
        panel = cv2.addWeighted(frame.rgb, 0.7, np.zeros_like(frame.rgb), 0.3, 0)
        depth = frame.calibration.project(points, frame.rgb.shape[:2])
        near = 255 - np.clip(255 * np.log2(np.maximum(depth, 3) / 3) / 4.3, 0, 255).astype(np.uint8)
        colors = cv2.cvtColor(cv2.applyColorMap(near, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
        for row, column in np.argwhere(depth > 0):
            cv2.circle(panel, (int(column), int(row)), 1, colors[row, column].tolist(), -1)
        cv2.putText(panel, name, (12, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2)
        panels.append(panel)
    return np.concatenate(panels)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["drops", "sweep", "picture"])
    parser.add_argument("--out", type=Path, help="of the picture")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--model", default="ssdnet-lite")
    parser.add_argument("--limit", type=int, default=51, help="frames of the drive")
    parser.add_argument("--age", type=int, default=1, help="of the scan before, in frames")
    parser.add_argument("--seed", type=int, default=3, help="of the rendered street")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    if arguments.part == "sweep":
        print("| motion, picture | returns | px median | px p95 | m median | m p95 |")
        print("|" + "---|" * 6)
        for turn in (0.0, 0.5):
            for later_ms in (0, 50):
                errors = sweep_errors(speed=15, turn=turn, later_ms=later_ms)
                for way, values in errors.items():
                    (px, m), (px95, m95) = np.percentile(values, [50, 95], axis=0)
                    print(
                        f"| 15 m/s, {turn:g} rad/s, {later_ms} ms later | {way} | {px:.2f} | "
                        f"{px95:.2f} | {m:.4f} | {m95:.4f} |"
                    )
        return
    if arguments.part == "picture":
        frames = list(rendered_drive(arguments.seed, 6))
        picture = cv2.cvtColor(draw_returns(frames), cv2.COLOR_RGB2BGR)
        if not cv2.imwrite(str(arguments.out), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]):
            raise OSError(f"cannot write {arguments.out}")
        return
    if arguments.data is None:
        drive = rendered_drive(arguments.seed, arguments.limit)
    else:
        drive = recorded_drive(arguments.data)
    frames = [frame for frame, _ in zip(drive, range(arguments.limit), strict=False)]
    with Predictor(arguments.model, threads=arguments.threads, size="frame") as predictor:
        table = score_drops(frames, predictor, age=arguments.age)
    names = ("whole", "still", "moving")
    print("| returns | " + " | ".join(f"{n} MAE | RMSE" for n in names) + " | flicker % |")
    print("|---|" + "---|" * 7)
    for way, row in table.items():
        cells = [f"{row[f'{name} {kind}']:.3f}" for name in names for kind in ("MAE", "RMSE")]
        print(f"| ({way}) {WAYS[way]} | {' | '.join(cells)} | {100 * row['flicker_depth']:.2f} |")
    counts = {name: round(table["d"][f"{name} n"]) for name in names}
    print(f"\n{len(frames) // 2} frames without their scan; scored pixels: {counts}")


if __name__ == "__main__":
    main()
