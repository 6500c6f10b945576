"""Overhead of a push stream over `Predictor.predict`, on the same frames from memory.

    python benchmarks/push_stream.py [--sizes 375x1242 ...] [--threads 2] [--rounds 7]
    python benchmarks/push_stream.py --rates [--threads 2] [--rounds 7]

Two ways run interleaved: `predict` back to back, and a stream into which a frame is pushed when the
last one was answered, for the additional latency of a single frame ("overhead").

With --rates a camera of 20 Hz beside a LiDAR of 10 Hz and one of 10 Hz beside it push live into
streams, interleaved, 30 s each, the depth 5 ms after its image: the age of the answers after the
first 2 s, from which on the periods are known. Take it on an idle machine.
"""

import argparse
import platform
import statistics
import time
from importlib.metadata import version

import numpy as np

from runtime import Predictor, PushStream
from runtime.run.engine_facts import machine_facts
from runtime.run.process import dedicate_process
from runtime.streams.frame_result import FrameResult
from runtime.sync.frame import Frame
from soak import resized_frames

SIZES = ("125x414", "375x1242")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), help="HEIGHTxWIDTH")
    parser.add_argument("--model", help="bundled name or path")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--frames", type=int, default=40, help="of a run")
    parser.add_argument("--rates", action="store_true", help="ages at 20 / 10 Hz and 10 / 10 Hz")
    arguments = parser.parse_args()
    if arguments.rates:
        print_rates(arguments.model, threads=arguments.threads, rounds=arguments.rounds)
        return
    print(
        f"{machine_facts().cpu}, {arguments.threads} threads, "
        f"onnxruntime {version('onnxruntime')}, "
        f"Python {platform.python_version()}; medians of {arguments.rounds} interleaved runs of "
        f"{arguments.frames} frames\n"
    )
    dedicate_process()
    print(
        "| size | predict ms | overhead a frame, median ms | p99 of predict | p99 of the stream |"
    )
    print("|" + "---|" * 5)
    for size in arguments.sizes:
        height, width = (int(side) for side in size.split("x"))
        with Predictor(arguments.model, size="frame", threads=arguments.threads) as predictor:
            resized = resized_frames((height, width))
            frames = [resized[number % len(resized)] for number in range(arguments.frames)]
            row = measure(predictor, frames, rounds=arguments.rounds)
        print(
            f"| {size} | {row['predict_ms']:.2f} | {row['overhead_ms']:.2f} | "
            f"{row['predict_p99_ms']:.1f} | {row['stream_p99_ms']:.1f} |",
            flush=True,
        )


def print_rates(model: str | None, *, threads: int, rounds: int, seconds: float = 30) -> None:
    """Print the ages at two rates of the camera."""
    ages_ms: dict[int, list[float]] = {20: [], 10: []}
    (frame, *_) = resized_frames((125, 414))
    dedicate_process()
    with Predictor(model, size="frame", threads=threads) as predictor:
        for _ in range(rounds):
            for rate, ages in ages_ms.items():
                ages += rate_ages(predictor, frame, rate=rate, seconds=seconds)
    print("| camera / LiDAR Hz | answers | age ms median | p99 |\n|---|---|---|---|")
    for rate, ages in ages_ms.items():
        median, p99 = np.quantile(ages, [0.5, 0.99], method="inverted_cdf")
        print(f"| {rate} / 10 | {len(ages)} | {median:.1f} | {p99:.1f} |")


def rate_ages(predictor: Predictor, frame: Frame, *, rate: int, seconds: float) -> list[float]:
    """Ages of the answers [ms] of a live stream in real time, without its first 2 s."""
    results: list[FrameResult] = []
    with PushStream(predictor, on_result=results.append) as stream:
        images = [(number / rate, stream.push_image) for number in range(int(seconds * rate))]
        depths = [(number / 10, stream.push_depth) for number in range(int(seconds * 10))]
        started = time.perf_counter()
        for stamp, push in sorted(
            images + depths, key=lambda each: each[0] + 0.005 * (each[1] == stream.push_depth)
        ):
            is_image = push == stream.push_image
            due_s = started + stamp + (0 if is_image else 0.005)
            time.sleep(max(0.0, due_s - time.perf_counter()))
            push(frame.rgb if is_image else frame.sparse_depth, stamp)
    return [result.age_ms for result in results if result.image_stamp >= 2]


def measure(predictor: Predictor, frames: list[Frame], *, rounds: int) -> dict[str, float]:
    """Time both ways interleaved, after one run of each to warm up."""
    alone_ms: list[float] = []
    stream_ms: list[float] = []
    for number in range(rounds + 1):
        alone = [_predict(predictor, frame) for frame in frames]
        pushed = _push(predictor, frames)
        if number:
            alone_ms += alone
            stream_ms += pushed
    overheads_ms = [one - other for one, other in zip(stream_ms, alone_ms, strict=True)]
    return {
        "predict_ms": statistics.median(alone_ms),
        "overhead_ms": statistics.median(overheads_ms),
        "predict_p99_ms": float(np.quantile(alone_ms, 0.99, method="inverted_cdf")),
        "stream_p99_ms": float(np.quantile(stream_ms, 0.99, method="inverted_cdf")),
    }


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
