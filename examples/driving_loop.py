"""The engine inside a 10 Hz loop: what to check before using a prediction.

    python examples/driving_loop.py [--rgb DIR --depth DIR --focal-length PX]

Plays a stream (the bundled one by default) at the sensor's rate, always takes the newest frame,
and shows how a stack distinguishes a good prediction from a degraded, invalid or late one.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from runtime import BUNDLED_FOCAL_LENGTH_PX, InputError, Predictor, bundled_frames, open_source

PERIOD_S = 0.1
DEADLINE_MS = 80.0


def main() -> None:
    """Play the stream once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rgb", type=Path)
    parser.add_argument("--depth", type=Path)
    parser.add_argument("--focal-length", type=float, help="fx in pixels of the images")
    arguments = parser.parse_args()
    if (arguments.rgb is None) != (arguments.depth is None):
        parser.error("give both --rgb and --depth, or neither")
    if arguments.rgb:
        source = open_source("folders", arguments.rgb, depth=arguments.depth)
        frames = [source.read(listed) for listed in source.list_frames()]
    else:
        frames = bundled_frames()

    focal_length_px = arguments.focal_length if arguments.rgb else BUNDLED_FOCAL_LENGTH_PX
    with Predictor(focal_length_px=focal_length_px) as predictor:
        # Memory and caches are ready for the camera's size before the first frame counts.
        height, width = frames[0].sparse_depth.shape
        predictor.warm_up((height, width), runs=3)
        names = [info.name for info in predictor.contract.classes]
        in_path = np.isin(np.arange(256), [names.index(n) for n in ("car", "pedestrian")])
        started = time.monotonic()
        done = -1
        while (newest := int((time.monotonic() - started) / PERIOD_S)) < len(frames):
            if newest == done:
                time.sleep(0.001)
                continue
            dropped, done = newest - done - 1, newest
            frame = frames[newest]
            stamp_s = started + newest * PERIOD_S  # when the sensors saw it
            try:
                prediction = predictor.predict(frame.rgb, frame.sparse_depth, stamp=stamp_s)
            except InputError as error:  # a wiring fault: the frame is unusable, the engine is not
                print(f"frame {newest}: {error}")
                continue
            age_ms = (time.monotonic() - prediction.stamp) * 1e3
            late = "LATE " if prediction.latency.total_ms > DEADLINE_MS else ""
            if not prediction.valid:
                print(f"frame {newest}: do not use: {', '.join(prediction.degraded)}")
                continue
            middle = slice(width * 2 // 5, width * 3 // 5)
            road_user = in_path[prediction.semantic[:, middle]]
            ahead = prediction.depth[:, middle][road_user]
            nearest = "  none"
            if ahead.size > 50:
                pixel = np.argsort(ahead)[ahead.size // 20]
                nearest = f"{ahead[pixel]:5.1f} m"
                if prediction.depth_uncertainty is not None:  # of a model with that head
                    scale = prediction.depth_uncertainty[:, middle][road_user][pixel]
                    nearest += f" give or take {scale:.1f} m"
            print(
                f"frame {newest}: nearest road user ahead {nearest}, age {age_ms:5.1f} ms, "
                f"dropped {dropped} {late}{' '.join(prediction.degraded)}"
            )


if __name__ == "__main__":
    main()
