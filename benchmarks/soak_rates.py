"""Sensors at their own rates on a moving car, with faults: is every answer flagged rightly?

    python benchmarks/soak_rates.py [--minutes 10] [--seed 0]

A camera of 20 Hz, a LiDAR of 10 Hz and poses of 100 Hz push from a thread each, in real time, with
jitter and lost messages, past walls across a road, at 15 m/s. Each minute, poses are 20 s on time,
10 s 60 ms late, 10 s 400 ms late, 10 s with a jump of 3 m every 2 s, and 10 s missing.

Every depth map that reached the network is compared with the wall: where the answer does not say
"depth_uncompensated", the returns must be at the time of the picture, else at that of their scan.
Exits with 1 if one is not, if a message is not accounted for, or if an answer lacks a pose although
poses on time, or 60 ms late, were there when its image was pushed; a busy machine delays them.
"""

import argparse
import random
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime import Predictor, PushStream
from runtime.io.calibration import Calibration
from runtime.run.process import dedicate_process
from runtime.streams.frame_result import FrameResult

SIZE = (64, 96)
SPEED, JUMP_M, WALLS_M = 15.0, 3.0, 60.0
CALIBRATION = Calibration(
    np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]]),
    np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
)
PHASES = ("on time", "on time", "60 ms late", "400 ms late", "jumps", "none")
PHASE_S = 10.0
TOLERANCE_M = 0.1
#: Poses that are this much older than an image are extrapolated to it: a little less than 100 ms.
REACH_S = 0.095


def phase(time_s: float) -> str:
    """How poses come at a time."""
    return PHASES[int(time_s / PHASE_S) % len(PHASES)]


def wall_ahead_m(time_s: float) -> float:
    """Distance to the next wall that is 20 m away at least."""
    return WALLS_M + 20 - (SPEED * time_s) % WALLS_M


def scan(time_s: float) -> NDArray[np.float32]:
    """Returns of that wall: float32 (N, 3)."""
    ahead = wall_ahead_m(time_s)
    side, up = np.meshgrid(np.linspace(-0.7, 0.7, 60) * ahead, np.linspace(-0.4, 0.4, 30) * ahead)
    points = np.stack([np.full(side.size, ahead), side.ravel(), up.ravel()], axis=1)
    return points.astype(np.float32)


def pose(time_s: float) -> NDArray[np.float64]:
    """The LiDAR's pose by an odometry that jumps in its phase."""
    matrix = np.eye(4)
    matrix[0, 3] = SPEED * time_s
    if phase(time_s) == "jumps":
        matrix[0, 3] += JUMP_M * (int(time_s / 2) % 2)
    return matrix


class Watched:
    """A predictor that keeps the depth maps by their stamps until they are compared."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
        self.focal_length_px = CALIBRATION.focal_length_px
        self.seen: dict[float, NDArray[np.float32]] = {}

    def predict(self, rgb: Any, sparse_depth: Any, *, stamp: Any = None, **others: Any) -> Any:
        """As `Predictor.predict`."""
        self.seen[stamp] = sparse_depth
        return self._predictor.predict(rgb, sparse_depth, stamp=stamp, **others)


def check(result: FrameResult, sparse_depth: NDArray[np.float32]) -> str | None:
    """What is wrong with an answer; None if nothing is."""
    degraded = result.prediction.degraded
    returns = sparse_depth[sparse_depth > 0]
    if result.depth_stamp is None:
        return "depth without a stamp" if len(returns) else None
    moved = "depth_uncompensated" not in degraded
    drove_s = result.image_stamp - result.depth_stamp if moved else 0.0
    off_m = float(np.median(returns)) - (wall_ahead_m(result.depth_stamp) - SPEED * drove_s)
    if abs(off_m) > TOLERANCE_M:
        return f"{off_m:+.2f} m off at {result.image_stamp:.3f} s with {degraded}"
    if moved != (result.depth_motion == "scan") or result.depth_reused != (
        "depth_reused" in degraded
    ):
        return f"{result.depth_motion} and {result.depth_reused} with {degraded}"
    return None


def soak_rates(predictor: Predictor, *, seconds: float, seed: int) -> tuple[list[str], str]:
    """Soak a stream; return what went wrong, and a report."""
    watched = Watched(predictor)
    found: list[str] = []
    flags: dict[str, Counter[str]] = defaultdict(Counter)
    newest = {"pose": -1.0}
    known: dict[float, float] = {}  # stamp of an image -> newest pose when it was pushed

    def take(result: FrameResult) -> None:
        problem = check(result, watched.seen.pop(result.image_stamp))
        if problem is not None:
            found.append(problem)
        stamp = result.image_stamp
        has_pose = known[stamp] >= stamp - REACH_S and stamp % PHASE_S > 0.5
        if has_pose and "no_pose" in result.prediction.degraded and phase(stamp) in PHASES[:3]:
            found.append(f"no_pose at {stamp:.3f} s, there was one of {known[stamp]:.3f} s")
        of = flags[phase(stamp)]
        of.update(["answers", *result.prediction.degraded])

    called: Counter[str] = Counter()
    started = time.monotonic()
    stream = PushStream(watched, calibration=CALIBRATION, pose_frame="lidar", on_result=take)

    def pace(name: str, period_s: float, lost: float) -> Iterator[float]:
        """Times of a sensor, at the moment when they are over."""
        chance = random.Random(f"{seed} {name}")
        for number in range(int(seconds / period_s)):
            at = (number + chance.uniform(-0.03, 0.03)) * period_s
            if chance.random() >= lost:
                yield at

    def run(name: str, times: Iterator[float], send: Callable[[float], Any]) -> None:
        for at in times:
            late = {"60 ms late": 0.06, "400 ms late": 0.4}.get(phase(at), 0.0)
            due = at + (late if name == "pose" else 0.005)
            time.sleep(max(0.0, started + due - time.monotonic()))
            called[name] += 1
            if name == "image":
                known[at] = newest["pose"]
            send(at)
            newest[name] = at

    image = np.random.default_rng(seed).integers(0, 255, (8, *SIZE, 3), np.uint8)
    sensors = {
        "image": (0.05, 0.02, lambda at: stream.push_image(image[int(at * 20) % 8], at)),
        "depth": (0.1, 0.05, lambda at: stream.push_points(scan(at), at)),
        "pose": (0.01, 0.05, lambda at: stream.push_pose(pose(at), at)),
    }
    threads = []
    for name, (period_s, lost, send) in sensors.items():
        times = pace(name, period_s, lost)
        if name == "pose":
            times = (at for at in times if phase(at) != "none")
        threads.append(threading.Thread(target=run, args=(name, times, send)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    stream.close()
    counts = stream.counts
    for name, of in (("image", counts.images), ("depth", counts.depths), ("pose", counts.poses)):
        if of.pushed != called[name] or of.pending:
            found.append(f"{called[name]} of {name} pushed, {of.pushed} counted, {of.pending} left")
    if sum(counts.errors.values()) + sum(counts.poses.errors.values()):
        found.append(f"errors {dict(counts.errors)}, of poses {dict(counts.poses.errors)}")
    lines = [f"poses {name}: {dict(of)}" for name, of in flags.items()]
    lines += [f"images {counts.images}", f"scans {counts.depths}", f"poses {counts.poses}"]
    lines += [f"reused {counts.reused}, camera only {counts.camera_only}"]
    return found, "\n".join([*lines, stream.statistics.table()])


def main() -> None:
    """Soak and print the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    dedicate_process()
    with Predictor("ssdnet-nano", threads=1) as predictor:
        predictor.warm_up(SIZE, runs=3)
        found, report = soak_rates(predictor, seconds=60 * arguments.minutes, seed=arguments.seed)
    print(report)
    if found:
        sys.exit(f"{len(found)} problems: " + "; ".join(found[:20]))
    print("every message is accounted for, every answer is flagged rightly")


if __name__ == "__main__":
    main()
