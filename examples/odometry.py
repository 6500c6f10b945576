"""A camera twice as fast as the LiDAR, and poses from an odometry beside the stream.

    pip install kiss-icp
    python examples/odometry.py --images image_02 --scans velodyne --calibration calib.txt

Images and scans are files of equal count, 10 a second. Every second scan is dropped, as if the
LiDAR had half the camera's rate. KISS-ICP (Vizzo et al. 2023, MIT) runs in a thread of its own and
pushes where the LiDAR was at each scan; the stream moves the returns to the time of each image.
"""

import argparse
import queue
import threading
from pathlib import Path

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.kiss_icp import KissICP
from numpy.typing import NDArray

from runtime import Predictor, PushStream
from runtime.io.calibration import Calibration
from runtime.io.images import read_rgb
from runtime.io.scan import read_scan
from runtime.live.frame_result import FrameResult

PERIOD_S = 0.1
Scan = tuple[NDArray[np.float32], float]


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

    def on_result(result: FrameResult) -> None:
        age = "none" if result.depth_age_ms is None else f"{result.depth_age_ms:.0f} ms old"
        flags = " ".join(result.prediction.degraded)
        print(f"{result.image_stamp:.1f} s: depth {age}, moved: {result.depth_motion} {flags}")

    with (
        Predictor() as predictor,
        PushStream(
            predictor,
            mode="replay",  # a car uses "live"
            calibration=Calibration.from_file(arguments.calibration),
            pose_frame="lidar",
            on_result=on_result,
        ) as stream,
    ):
        to_odometry: queue.Queue[Scan | None] = queue.Queue(maxsize=4)

        def odometry() -> None:
            # The scans of these files have no time a point; with them, deskew = True.
            config = load_config(None)
            config.data.deskew = False
            kiss_icp = KissICP(config)
            while (scan := to_odometry.get()) is not None:
                points, stamp = scan
                kiss_icp.register_frame(points[:, :3].astype(np.float64), np.zeros(0))
                stream.push_pose(kiss_icp.last_pose, stamp)

        def lidar() -> None:
            for number, path in enumerate(scans):
                if number % 2 == 0:
                    points = read_scan(path)
                    to_odometry.put((points, number * PERIOD_S))
                    stream.push_points(points, number * PERIOD_S)
            to_odometry.put(None)

        def camera() -> None:
            for number, path in enumerate(images):
                stream.push_image(read_rgb(path), number * PERIOD_S)

        threads = [threading.Thread(target=each) for each in (odometry, lidar, camera)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    counts = stream.counts
    print(f"{counts.images.answered} answers, {counts.reused} with the scan before")


if __name__ == "__main__":
    main()
