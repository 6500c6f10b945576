"""A recording of a camera twice as fast as the LiDAR, with poses from an odometry.

    pip install -c constraints.txt ".[cpu,odometry]"
    python examples/odometry.py --images image_02 --scans velodyne --calibration calib.txt

Images and scans are files of equal count, 10 a second. Every second scan is dropped, as if the
LiDAR had half the camera's rate. KISS-ICP (Vizzo et al. 2023, MIT) says where the LiDAR was at each
scan; the returns are moved to the time of each image. A car pushes the same messages into a
`PushStream`.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from runtime import (
    Odometry,
    Predictor,
    ReplayMessage,
    Rig,
    StreamCounter,
    read_rgb,
    read_scan,
    replay,
)

PERIOD_S = 0.1


def main() -> None:
    """Replay the drive once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--scans", type=Path, required=True)
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=20)
    arguments = parser.parse_args()
    images = sorted(arguments.images.iterdir())[: arguments.frames]
    scans = sorted(arguments.scans.iterdir())[: arguments.frames]
    counter = StreamCounter()
    with Predictor() as predictor:
        for answer in replay(
            predictor,
            drive(images, scans),
            Rig(calibration=arguments.calibration, pose_frame="lidar", scan_stamp="middle"),
            counter=counter,
        ):
            age = "none" if answer.depth_age_ms is None else f"{answer.depth_age_ms:.0f} ms old"
            flags = " ".join(answer.prediction.degraded)
            print(f"{answer.image_stamp:.1f} s: depth {age}, moved: {answer.depth_motion} {flags}")
    counts = counter.counts
    print(f"{counts.images.answered} answers, {counts.reused} with the scan before")


def drive(images: Sequence[Path], scans: Sequence[Path]) -> Iterator[ReplayMessage]:
    """Yield the messages of camera, LiDAR and odometry in the order of time."""
    odometry = Odometry()
    for number, (image, scan) in enumerate(zip(images, scans, strict=True)):
        stamp = number * PERIOD_S
        yield "image", read_rgb(image), stamp
        if number % 2 == 0:
            points = read_scan(scan)
            yield "points", points, stamp
            yield "pose", odometry.add(points), stamp


if __name__ == "__main__":
    main()
