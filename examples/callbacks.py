"""The engine between the callbacks of a stack: sensors push from their own threads.

    python examples/callbacks.py [--frames N] [--period-s S]

Two threads stand in for the drivers of a camera and a LiDAR and push the bundled stream; a third,
the stream's own, calls `on_result` with each result. No driver waits for inference.
"""

import argparse
import threading
import time

from runtime import BUNDLED_FOCAL_LENGTH_PX, FrameResult, Predictor, PushStream, bundled_frames

DEADLINE_MS = 80.0
LIDAR_LATE_S = 0.01  # its stamps minus the camera's


def main() -> None:
    """Push the stream once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--period-s", type=float, default=0.1)
    arguments = parser.parse_args()
    frames = bundled_frames()[: arguments.frames]

    def on_result(result: FrameResult) -> None:
        prediction = result.prediction
        if not prediction.valid:
            print(f"{result.image_stamp:.2f} s: do not use: {', '.join(prediction.degraded)}")
            return
        late = "" if result.deadline_met else "LATE "
        partner = "no depth" if result.skew_ms is None else f"skew {result.skew_ms:.0f} ms"
        print(
            f"{result.image_stamp:.2f} s: {result.latency_ms:.0f} ms, {partner} "
            f"{late}{' '.join(prediction.degraded + result.health)}".rstrip()
        )

    with Predictor(focal_length_px=BUNDLED_FOCAL_LENGTH_PX) as predictor:
        predictor.warm_up(frames[0].sparse_depth.shape)
        with PushStream(
            predictor,
            deadline_ms=DEADLINE_MS,
            on_result=on_result,
        ) as stream:

            def camera() -> None:
                for number, frame in enumerate(frames):
                    stream.push_image(frame.rgb, number * arguments.period_s)
                    time.sleep(arguments.period_s)

            def lidar() -> None:
                for number, frame in enumerate(frames):
                    stamp_s = number * arguments.period_s + LIDAR_LATE_S
                    stream.push_depth(frame.sparse_depth, stamp_s)
                    time.sleep(arguments.period_s)

            drivers = [threading.Thread(target=camera), threading.Thread(target=lidar)]
            for driver in drivers:
                driver.start()
            for driver in drivers:
                driver.join()
        for sensor, counts in (("image", stream.counts.images), ("depth", stream.counts.depths)):
            others = counts.pushed - counts.answered
            print(f"{sensor}: {counts.pushed} pushed, {counts.answered} answered, {others} not")


if __name__ == "__main__":
    main()
