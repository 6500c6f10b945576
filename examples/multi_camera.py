"""Several cameras in one call: the frames of one moment in, a prediction for each camera out.

    python examples/multi_camera.py [--cameras N] [--moments M]

The bundled stream replaces the cameras, each a few frames behind the one before. The last one has
another resolution, and therefore runs as a batch of its own.
"""

import argparse

import cv2
import numpy as np

from runtime import BUNDLED_FOCAL_LENGTH_PX, Predictor, bundled_frames, move_returns

FRAMES_APART = 3
SMALLER = (192, 624)  # (height, width) of the last camera: three quarters


def main() -> None:
    """Play the first moments."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cameras", type=int, default=3)
    parser.add_argument("--moments", type=int, default=5)
    arguments = parser.parse_args()
    frames = bundled_frames()
    names = [f"camera {number}" for number in range(arguments.cameras)]
    focal_lengths_px = [BUNDLED_FOCAL_LENGTH_PX] * len(names)
    focal_lengths_px[-1] *= SMALLER[0] / frames[0].rgb.shape[0]

    with Predictor() as predictor:
        for moment in range(arguments.moments):
            batch = []
            for number in range(len(names)):
                frame = frames[(moment + FRAMES_APART * number) % len(frames)]
                rgb, sparse_depth = frame.rgb, frame.sparse_depth
                if number == len(names) - 1:
                    rgb = cv2.resize(rgb, SMALLER[::-1], interpolation=cv2.INTER_AREA)
                    sparse_depth = move_returns(sparse_depth, SMALLER)
                batch.append((rgb, sparse_depth))
            predictions = predictor.predict_batch(
                batch, focal_lengths_px=focal_lengths_px, stamps=names
            )
            for prediction in predictions:
                height, width = prediction.frame_size
                ahead = prediction.depth[height // 2 :, width * 2 // 5 : width * 3 // 5]
                warning = "" if prediction.valid else "do not use: "
                print(
                    f"moment {moment}, {prediction.stamp}, {height} x {width}: {warning}"
                    f"{np.median(ahead):5.1f} m ahead at the median "
                    f"{' '.join(prediction.degraded)}".rstrip()
                )
            print(f"  all of them in {predictions[0].latency.total_ms:.0f} ms")


if __name__ == "__main__":
    main()
