"""Overhead of a push stream over `Predictor.predict`, on the same frames from memory.

    python benchmarks/push_stream.py [--sizes 375x1242 ...] [--threads 2]

Two ways run interleaved: calls of `predict` one after the other, and a stream into which each frame
is pushed when the one before was answered. Their difference is the additional latency of a single
frame ("overhead").
"""

import argparse
import platform
import statistics
import time
from importlib.metadata import version

from runtime import Predictor, PushStream
from runtime.app.run.pipeline import dedicate_process
from runtime.command.machine import machine_facts
from runtime.streams.frame import Frame
from soak import resized_frames

SIZES = ("125x414", "375x1242")
ROUNDS, FRAMES = 7, 40


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), help="HEIGHTxWIDTH")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    print(
        f"{machine_facts().cpu}, {arguments.threads} threads, "
        f"onnxruntime {version('onnxruntime')}, "
        f"Python {platform.python_version()}; medians of {ROUNDS} interleaved runs of "
        f"{FRAMES} frames\n"
    )
    dedicate_process()
    print("| size | predict ms | overhead a frame, median ms |\n|---|---|---|")
    for size in arguments.sizes:
        height, width = (int(side) for side in size.split("x"))
        with Predictor(size="frame", threads=arguments.threads) as predictor:
            resized = resized_frames((height, width))
            frames = [resized[number % len(resized)] for number in range(FRAMES)]
            predict_ms, overhead_ms = measure(predictor, frames)
        print(f"| {size} | {predict_ms:.2f} | {overhead_ms:.2f} |", flush=True)


def measure(predictor: Predictor, frames: list[Frame]) -> tuple[float, float]:
    """Return the medians [ms] of `predict` and of the overhead, after one run of each way."""
    alone_ms: list[float] = []
    stream_ms: list[float] = []
    for number in range(ROUNDS + 1):
        alone = [_predict(predictor, frame) for frame in frames]
        pushed = _push(predictor, frames)
        if number:
            alone_ms += alone
            stream_ms += pushed
    overheads_ms = [one - other for one, other in zip(stream_ms, alone_ms, strict=True)]
    return statistics.median(alone_ms), statistics.median(overheads_ms)


def _predict(predictor: Predictor, frame: Frame) -> float:
    started = time.perf_counter()
    predictor.predict(frame.rgb, frame.sparse_depth)
    return (time.perf_counter() - started) * 1e3


def _push(predictor: Predictor, frames: list[Frame]) -> list[float]:
    times_ms = []
    with PushStream(predictor, check_depth=False) as stream:
        for number, frame in enumerate(frames):
            started = time.perf_counter()
            stream.push_image(frame.rgb, number / 10)
            stream.push_depth(frame.sparse_depth, number / 10)
            next(stream)
            times_ms.append((time.perf_counter() - started) * 1e3)
    return times_ms


if __name__ == "__main__":
    main()
