"""Tries to break a stream with random sensor faults and threads in any order.

    python benchmarks/soak.py [--minutes 1] [--size 375x1242] [--threads 2]

A camera thread and a LiDAR thread push for `--minutes` at 1.5 times the rate that the model reaches
on this machine. Both send faults now and then: bursts of NaN, empty, halved and wrongly sized depth
maps, black, frozen and wrongly sized images, and late, double, missing and jumping stamps. Readers
are killed and started again. Each image comes with a pose, and the stream remembers two seconds.

The program exits with 1 if a message is not accounted for, or if the process grew by more than 64
MB after the first fifth.
"""

import argparse
import itertools
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from runtime import Calibration, InputError, Predictor, PushStream, Rig
from runtime.app.run.pipeline import dedicate_process
from runtime.contract.resize import move_returns
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.streams.frame import Frame
from runtime.streams.messages import Depth, Image
from runtime.streams.statistics import StreamStatistics
from runtime.streams.stream_counter import MessageCounts, StreamCounts

_LARGEST_GROWTH_MB = 64
_FAULTY = 0.1  # share of the messages that are faulty
_WALL_M, _STEP_M = 20, 0.4  # way to a wall, and along it between two frames
_LOAD = 1.5  # rate divided by the rate that the model reaches


def resident_mb() -> float:
    """Return the memory of this process that is in use, MB."""
    return float(psutil.Process().memory_info().rss / 1e6)


class ReaderKilledError(Exception):
    """Ends a reader's thread in the middle of its work."""


@dataclass
class Soaked:
    """The result of the live part.

    Attributes:
        called: number of pushes by sensor, counted by the sensors.
        remembering: answers with returns of earlier scans.
        faults: number of injected faults by kind.
        resident_mb: memory of the process over time.
    """

    called: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    levels: Counter[str] = field(default_factory=Counter)
    results: int = 0
    remembering: int = 0
    resident_mb: list[float] = field(default_factory=list)
    counts: StreamCounts | None = None
    statistics: StreamStatistics | None = None

    @property
    def growth_mb(self) -> float:
        """Growth of the process between the first fifth and the end."""
        warm = self.resident_mb[len(self.resident_mb) // 5 :]
        return warm[-1] - warm[0] if warm else 0.0

    def problems(self) -> list[str]:
        """Violations; [] if there are none."""
        assert self.counts is not None
        found = []
        if self.counts.pending:
            found.append(f"{self.counts.pending} messages have no outcome")
        for sensor, counts in by_sensor(self.counts).items():
            if counts.pushed != self.called[sensor]:
                found.append(f"{self.called[sensor]} of {sensor} pushed, {counts.pushed} counted")
        if self.counts.images.answered != self.results:
            found.append(f"{self.results} results, {self.counts.images.answered} counted")
        errors = sum(sum(each.errors.values()) for each in by_sensor(self.counts).values())
        if errors < self.refused:
            found.append(f"{self.refused} refused, {errors} errors")
        if self.growth_mb > _LARGEST_GROWTH_MB:
            found.append(f"the process grew by {self.growth_mb:.0f} MB")
        return found


def by_sensor(counts: StreamCounts) -> dict[str, MessageCounts]:
    """Return the counts of each sensor."""
    return {"image": counts.images, "depth": counts.depths, "pose": counts.poses}


def soak(
    predictor: Any,
    frames: list[Frame],
    *,
    period_s: float,
    go_on: Callable[[int], bool],
) -> Soaked:
    """Push frames of a camera and a LiDAR until `go_on(number of the frame)` is False.

    `period_s` is the time between frames of a sensor; 0 stands for as fast as possible.
    """
    soaked = Soaked()
    lock = threading.Lock()
    (height, width), focal_px = frames[0].rgb.shape[:2], BUNDLED_FOCAL_LENGTH_PX
    intrinsics = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
    calibration = Calibration(intrinsics, np.eye(4), (height, width))
    stream = PushStream(
        predictor,
        Rig(calibration=calibration, pose_frame="camera", memory_s=2.0),
        deadline_ms=100,
        on_state=lambda state: soaked.levels.update([str(state.level)]),
    )

    def push(sensor: str, method: Any, data: Any, stamp: Any) -> None:
        with lock:
            soaked.called[sensor] += 1
        try:
            method(data, stamp)
        except InputError:
            with lock:
                soaked.refused += 1

    def read(sensor: str, first: int) -> None:
        chance = random.Random(f"{sensor} {first}")
        method = stream.push_image if sensor == "image" else stream.push_depth
        shift = 0.0
        for number in itertools.count(first):
            if not go_on(number):
                return
            reached[sensor] = number
            frame = frames[number % len(frames)]
            data: Any = frame.rgb if sensor == "image" else frame.sparse_depth
            stamp: Any = number * 0.1 + shift
            if chance.random() < _FAULTY:
                kind, data, stamp, shift = _fault(chance, sensor, data, stamp, shift)
                with lock:
                    soaked.faults[kind] += 1
                if kind == "killed":
                    raise ReaderKilledError
            if sensor == "image":
                pose = np.eye(4)
                pose[0, 3] = _STEP_M * number
                push("pose", stream.push_pose, pose, stamp)
            push(sensor, method, data, stamp)
            if period_s:
                time.sleep(max(0.0, started + number * period_s - time.perf_counter()))

    def keep_reading(sensor: str) -> None:
        """Start the reader again whenever it was killed, three frames later."""
        while go_on(reached[sensor]):
            try:
                read(sensor, reached[sensor])
                break
            except ReaderKilledError:
                reached[sensor] += 3

    reached = {"image": 0, "depth": 0}
    started = time.perf_counter()
    readers = [
        threading.Thread(target=keep_reading, args=(sensor,)) for sensor in ("image", "depth")
    ]

    def close_after_the_readers() -> None:
        for reader in readers:
            reader.join()
        stream.close()

    closer = threading.Thread(target=close_after_the_readers)
    for thread in (*readers, closer):
        thread.start()
    sampled = 0.0
    for result in stream:
        soaked.results += 1
        soaked.remembering += result.memory_returns > 0
        if time.perf_counter() - sampled > 0.5:
            sampled = time.perf_counter()
            soaked.resident_mb.append(resident_mb())
    closer.join()
    soaked.counts, soaked.statistics = stream.counts, stream.statistics
    return soaked


def _lower_half_nan(depth: NDArray[Any]) -> NDArray[Any]:
    return np.where(np.arange(len(depth))[:, None] < len(depth) // 2, depth, np.float32(np.nan))


def _left_half(depth: NDArray[Any]) -> NDArray[Any]:
    return np.where(np.arange(depth.shape[1]) < depth.shape[1] // 2, depth, np.float32(0))


# What each fault makes of an image or a depth map; the others change only the stamp.
_CHANGES: dict[str, Callable[[NDArray[Any]], Any]] = {
    "black": np.zeros_like,
    "frozen": partial(np.full_like, fill_value=77),
    "None": lambda image: None,
    "nan": _lower_half_nan,
    "inf": partial(np.full_like, fill_value=-np.inf),
    "empty": np.zeros_like,
    "half": _left_half,
    "size": lambda data: data[:-3],
    "type": lambda data: data.astype(np.float64),
}
_STAMPS = ("late", "double", "no stamp", "killed")
_KINDS = {
    "image": ("black", "frozen", "None", "size", "type", "jump", *_STAMPS),
    "depth": ("nan", "inf", "empty", "half", "size", "type", *_STAMPS),
}


def _fault(
    chance: random.Random, sensor: str, data: Any, stamp: float, shift: float
) -> tuple[str, Any, Any, float]:
    kind = chance.choice(_KINDS[sensor])
    change = _CHANGES.get(kind)
    return kind, data if change is None else change(data), *_stamp_fault(kind, stamp, shift)


def _stamp_fault(kind: str, stamp: float, shift: float) -> tuple[Any, float]:
    """Return the stamp that is sent, and by how much the sensor's clock is off from then on."""
    match kind:
        case "late":
            return stamp - 0.35, shift
        case "double":
            return stamp - 0.1, shift
        case "no stamp":
            return None, shift
        case "jump":
            return stamp, 0.0 if shift else -5.0
    return stamp, shift


def resized_frames(size: tuple[int, int]) -> list[Frame]:
    """Return the bundled stream at another size, its returns on a wall, which fits the poses."""
    depths = (move_returns(frame.sparse_depth, size) for frame in bundled_frames())
    return [
        Frame(
            Image(cv2.resize(frame.rgb, size[::-1])),
            Depth(np.where(depth > 0, np.float32(_WALL_M), depth)),
        )
        for frame, depth in zip(bundled_frames(), depths, strict=True)
    ]


def main() -> None:
    """Soak and print the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--size", default="375x1242", help="HEIGHTxWIDTH")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    dedicate_process()
    height, width = (int(side) for side in arguments.size.split("x"))
    frames = resized_frames((height, width))
    with Predictor(threads=arguments.threads) as predictor:
        predictor.warm_up((height, width), runs=3)
        times_ms = [
            predictor.predict(frame.rgb, frame.sparse_depth).latency.total_ms for frame in frames
        ]
        period_s = float(np.median(times_ms)) / 1e3 / _LOAD
        end = time.monotonic() + arguments.minutes * 60
        soaked = soak(
            predictor, frames, period_s=period_s, go_on=lambda number: time.monotonic() < end
        )
    assert soaked.counts is not None
    assert soaked.statistics is not None
    print(f"pushed at {1 / period_s:.1f} Hz a sensor for {arguments.minutes:g} min")
    for name, counts in by_sensor(soaked.counts).items():
        print(
            f"{name}: {counts.pushed} pushed = {counts.answered} answered + dropped "
            f"{dict(counts.dropped)} + unmatched {dict(counts.unmatched)} + errors "
            f"{dict(counts.errors)} + {counts.pending} pending"
        )
    print(f"faults: {dict(soaked.faults)}\nwatchdog: {dict(soaked.levels)}")
    print(f"{soaked.remembering} of {soaked.results} answers with remembered returns")
    print(soaked.statistics.table())
    memory = soaked.resident_mb or [0.0]
    print(
        f"resident MB: first {memory[0]:.0f}, after a fifth {memory[len(memory) // 5]:.0f}, "
        f"last {memory[-1]:.0f}, most {max(memory):.0f}"
    )
    if problems := soaked.problems():
        sys.exit("; ".join(problems))
    print("every message is accounted for")


if __name__ == "__main__":
    main()
