"""Overhead of a push stream over `Predictor.predict`, on the same frames from memory, in turns.

    python benchmarks/push_stream.py [--sizes 375x1242 ...] [--threads 2] [--rounds 7]

Three ways take turns: `predict` back to back; a replay that a thread pushes into, which gives the
throughput; and a live stream into which a frame is pushed when the last one was answered, which
gives what a single frame waits longer ("overhead"). Ratios are of the same round; "processor" is
the time of all threads, which other programs lengthen less.
"""

import argparse
import platform
import statistics
import threading
import time
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np

from runtime import Predictor, PushStream
from runtime.engine_facts import cpu_name
from runtime.resize import move_returns
from runtime.run.process import dedicate_process
from runtime.sources.bundled_stream import bundled_frames
from runtime.sources.frames import Frame

SIZES = ("125x414", "375x1242")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), help="HEIGHTxWIDTH")
    parser.add_argument("--model", help="bundled name or path")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--frames", type=int, default=40, help="of a turn")
    arguments = parser.parse_args()
    print(
        f"{cpu_name()}, {arguments.threads} threads, onnxruntime {version('onnxruntime')}, "
        f"Python {platform.python_version()}; medians of {arguments.rounds} interleaved turns of "
        f"{arguments.frames} frames\n"
    )
    dedicate_process()
    print(
        "| size | predict ms | replay: throughput against predict | of processor time | "
        "live: overhead a frame, median ms | p99 of predict | p99 of live |"
    )
    print("|" + "---|" * 7)
    for size in arguments.sizes:
        height, width = (int(side) for side in size.split("x"))
        with Predictor(arguments.model, size="frame", threads=arguments.threads) as predictor:
            frames = _frames((height, width), arguments.frames)
            row = measure(predictor, frames, rounds=arguments.rounds)
        print(
            f"| {size} | {row['predict_ms']:.2f} | {row['throughput']:.3f} | "
            f"{row['processor']:.3f} | {row['overhead_ms']:.2f} | {row['predict_p99_ms']:.1f} | "
            f"{row['live_p99_ms']:.1f} |",
            flush=True,
        )


def measure(predictor: Predictor, frames: list[Frame], *, rounds: int) -> dict[str, float]:
    """Time the three ways in turns, after one of each that does not count."""
    turns: list[dict[str, Any]] = []
    for _ in range(rounds + 1):
        turn = {
            "predict": _timed(lambda: [_predict(predictor, frame) for frame in frames]),
            "replay": _timed(lambda: _replay(predictor, frames)),
            "live": _timed(lambda: _live(predictor, frames)),
        }
        turns.append(turn)
    turns = turns[1:]

    def ratio(of: int) -> float:
        return statistics.median(turn["predict"][of] / turn["replay"][of] for turn in turns)

    alone = [time_ms for turn in turns for time_ms in turn["predict"][2]]
    live = [time_ms for turn in turns for time_ms in turn["live"][2]]
    return {
        "predict_ms": statistics.median(alone),
        "throughput": ratio(0),
        "processor": ratio(1),
        "overhead_ms": statistics.median(
            one - other
            for turn in turns
            for one, other in zip(turn["live"][2], turn["predict"][2], strict=True)
        ),
        "predict_p99_ms": float(np.quantile(alone, 0.99, method="inverted_cdf")),
        "live_p99_ms": float(np.quantile(live, 0.99, method="inverted_cdf")),
    }


def _predict(predictor: Predictor, frame: Frame) -> float:
    started = time.perf_counter()
    predictor.predict(frame.rgb, frame.sparse_depth)
    return (time.perf_counter() - started) * 1e3


def _replay(predictor: Predictor, frames: list[Frame]) -> None:
    with PushStream(predictor, mode="replay") as stream:

        def push() -> None:
            for number, frame in enumerate(frames):
                stream.push_image(frame.rgb, number / 10)
                stream.push_depth(frame.sparse_depth, number / 10)
            stream.close()

        pusher = threading.Thread(target=push)
        pusher.start()
        answered = sum(1 for _ in stream)
        pusher.join()
    if answered != len(frames):
        raise RuntimeError(f"{answered} of {len(frames)} frames were answered")


def _live(predictor: Predictor, frames: list[Frame]) -> list[float]:
    times_ms = []
    with PushStream(predictor, mode="live") as stream:
        for number, frame in enumerate(frames):
            started = time.perf_counter()
            stream.push_image(frame.rgb, number / 10)
            stream.push_depth(frame.sparse_depth, number / 10)
            next(stream)
            times_ms.append((time.perf_counter() - started) * 1e3)
    return times_ms


def _timed(call: Any) -> tuple[float, float, Any]:
    """Wall and processor time of a call [s], and what it returned."""
    started, worked = time.perf_counter(), time.process_time()
    returned = call()
    return time.perf_counter() - started, time.process_time() - worked, returned


def _frames(size: tuple[int, int], count: int) -> list[Frame]:
    """The bundled stream at another size; no image is the same as the one before it."""
    frames = bundled_frames()
    resized = [
        Frame(cv2.resize(frame.rgb, size[::-1]), move_returns(frame.sparse_depth, size))
        for frame in frames
    ]
    return [resized[number % len(resized)] for number in range(count)]


if __name__ == "__main__":
    main()
