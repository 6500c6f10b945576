"""How the consistency figures of a stream react when camera and LiDAR no longer fit.

    python benchmarks/consistency.py [--threads 2]

The bundled stream is pushed three times. From the second pass on, each row of the table has one
fault: a calibration that is rotated by 1° about an axis of the camera, depth maps of the frame
before (100 ms), or depths that are multiplied by a scale. The table has the mean of each figure
over the last pass, and its distance from the healthy row in standard deviations of the healthy
stream's frames; for the scale, which is measured twice in a pass, it has the difference.
"""

import argparse

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import Predictor, PushStream, project_points
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.streams.frame import Frame

FAULTS = ("healthy", "pitch 1°", "yaw 1°", "100 ms late", "scale 1.1")
# The axis of the camera about which each fault turns.
AXES = {"pitch 1°": (1.0, 0.0, 0.0), "yaw 1°": (0.0, -1.0, 0.0)}
FIGURES = ("holdout_error", "edge_agreement", "scale_error")
PASSES = 3


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", help="bundled name or path")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    frames = bundled_frames()
    series = {}
    with Predictor(
        arguments.model, threads=arguments.threads, focal_length_px=BUNDLED_FOCAL_LENGTH_PX
    ) as predictor:
        for fault in FAULTS:
            series[fault] = run(predictor, frames, fault)
    print("| fault | " + " | ".join(FIGURES) + " |\n|---|" + "---|" * len(FIGURES))
    healthy = series["healthy"][-len(frames) :]
    for fault, values in series.items():
        last = values[-len(frames) :]
        moved = last.mean(axis=0) - healthy.mean(axis=0)
        sigmas = moved / np.maximum(healthy.std(axis=0), 1e-9)
        cells = [
            f"{mean:.3f} ({by:+.3f})" if name == "scale_error" else f"{mean:.3f} ({sigma:+.1f})"
            for name, mean, by, sigma in zip(FIGURES, last.mean(axis=0), moved, sigmas, strict=True)
        ]
        print(f"| {fault} | " + " | ".join(cells) + " |")


def run(predictor: Predictor, frames: list[Frame], fault: str) -> NDArray[np.float64]:
    """Return the running figures after each frame, float64 (passes * frames, figures)."""
    values = []
    with PushStream(predictor, consistency=0.05) as stream:
        for number in range(PASSES * len(frames)):
            place = number % len(frames)
            depth = frames[place].sparse_depth
            if number >= len(frames):
                depth = spoil(fault, frames, place)
            stream.push_image(frames[place].rgb, number / 10)
            stream.push_depth(depth, number / 10)
            consistency = next(stream).consistency
            values.append([getattr(consistency, name) for name in FIGURES])
    return np.array(values, dtype=np.float64)


def spoil(fault: str, frames: list[Frame], place: int) -> NDArray[np.float32]:
    """Return the depth map that a LiDAR with this fault would give."""
    depth = frames[place].sparse_depth
    if fault == "scale 1.1":
        return depth * np.float32(1.1)
    if fault == "100 ms late":
        return frames[max(place - 1, 0)].sparse_depth
    if fault in AXES:
        return rotated(depth, AXES[fault], degrees=1.0)
    return depth


def rotated(
    depth: NDArray[np.float32], axis: tuple[float, float, float], *, degrees: float
) -> NDArray[np.float32]:
    """Return the depth map of the same returns in a camera rotated about this axis."""
    height, width = depth.shape
    focal_px = BUNDLED_FOCAL_LENGTH_PX
    intrinsics = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1.0]])
    row, column = np.nonzero(depth)
    z = depth[row, column]
    pixels = np.stack([column, row, np.ones_like(row)])
    points = (np.linalg.inv(intrinsics) @ pixels * z).T.astype(np.float32)
    rotation = np.eye(4)
    rotation[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.array(axis))[0]
    return project_points(points, intrinsics, rotation, (height, width))


if __name__ == "__main__":
    main()
