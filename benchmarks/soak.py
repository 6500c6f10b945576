"""Try to break streams by chance: faulty sensors, threads in any order, signals at any moment.

    python benchmarks/soak.py [--minutes 1] [--rounds 20] [--load 1.5] [--size 375x1242]

Three parts, each with random cases of `--seed`:

live     A camera and a LiDAR thread push for `--minutes` at `--load` times the rate that the model
         reaches here. Both send faults now and then: bursts of NaN, empty, half and wrongly sized
         depth maps, black, frozen and wrongly sized images, late, double, missing and jumping
         stamps; readers are killed and started again.
signals  `--rounds` programs push, read or iterate until a signal handler stops them, close the
         stream, then exit while another stream predicts.
sources  `--rounds` copies of the bundled recording have a damaged or special file each; reading
         must end in an InputError or in a frame, and all other frames must be read as they are.

Exits with 1 if a message is not accounted for, if a stream ended by itself, if the process grew by
more than 64 MB after the first fifth, if a program hangs or fails, or if a damaged source is read
wrongly.
"""

import argparse
import contextlib
import itertools
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime import InputError, Predictor, PushStream
from runtime.resize import move_returns
from runtime.run.process import dedicate_process
from runtime.sources.bundled_stream import bundled_frames, bundled_stream
from runtime.sources.registry import open_source
from runtime.streams.statistics import StreamStatistics
from runtime.streams.stream_counter import StreamCounts
from runtime.sync.frame import Frame, Message

_LARGEST_GROWTH_MB = 64
_FAULTY = 0.1  # share of the messages


class ReaderKilledError(Exception):
    """Ends a reader's thread in the middle of its work."""


@dataclass
class Soaked:
    """The result of the live part.

    called: pushes by sensor, counted by the sensors. faults: injected, by kind. resident_mb: of the
    process, over time.
    """

    called: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    levels: Counter[str] = field(default_factory=Counter)
    invalid: int = 0
    results: int = 0
    resident_mb: list[float] = field(default_factory=list)
    counts: StreamCounts | None = None
    statistics: StreamStatistics | None = None

    @property
    def growth_mb(self) -> float:
        """Of the process between the first fifth and the end."""
        warm = self.resident_mb[len(self.resident_mb) // 5 :]
        return warm[-1] - warm[0] if warm else 0.0

    def problems(self) -> list[str]:
        """Violations; [] if there are none."""
        assert self.counts is not None
        found = []
        if self.counts.pending:
            found.append(f"{self.counts.pending} messages have no outcome")
        for sensor, counts in (("image", self.counts.images), ("depth", self.counts.depths)):
            if counts.pushed != self.called[sensor]:
                found.append(f"{self.called[sensor]} of {sensor} pushed, {counts.pushed} counted")
        if self.counts.images.answered != self.results:
            found.append(f"{self.results} results, {self.counts.images.answered} counted")
        if sum(self.counts.errors.values()) < self.refused:
            found.append(f"{self.refused} refused, {sum(self.counts.errors.values())} errors")
        if self.growth_mb > _LARGEST_GROWTH_MB:
            found.append(f"the process grew by {self.growth_mb:.0f} MB")
        return found


def soak(
    predictor: Any,
    frames: list[Frame],
    *,
    period_s: float,
    go_on: Callable[[int], bool],
    seed: int = 0,
) -> Soaked:
    """Push frames of a camera and a LiDAR until `go_on(number of the frame)` is False.

    period_s: between frames of a sensor; 0 = as fast as possible
    """
    soaked = Soaked()
    lock = threading.Lock()
    stream = PushStream(
        predictor,
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
        chance = random.Random(f"{seed} {sensor} {first}")
        fault = _image_fault if sensor == "image" else _depth_fault
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
                kind, data, stamp, shift = fault(chance, data, stamp, shift)
                with lock:
                    soaked.faults[kind] += 1
                if kind == "killed":
                    raise ReaderKilledError
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
        soaked.invalid += not result.prediction.valid
        if time.perf_counter() - sampled > 0.5:
            sampled = time.perf_counter()
            soaked.resident_mb.append(resident_mb())
    closer.join()
    soaked.counts, soaked.statistics = stream.counts, stream.statistics
    return soaked


def _image_fault(
    chance: random.Random, rgb: NDArray[np.uint8], stamp: float, shift: float
) -> tuple[str, Any, Any, float]:
    kind = chance.choice(
        ["black", "frozen", "size", "type", "late", "double", "no stamp", "jump", "killed", "None"]
    )
    changed: dict[str, Any] = {
        "black": np.zeros_like(rgb),
        "frozen": np.full_like(rgb, 77),
        "size": rgb[:-3],
        "type": rgb.astype(np.float32),
        "None": None,
    }
    return kind, changed.get(kind, rgb), *_stamp_fault(kind, stamp, shift)


def _depth_fault(
    chance: random.Random, depth: NDArray[np.float32], stamp: float, shift: float
) -> tuple[str, Any, Any, float]:
    kind = chance.choice(
        ["nan", "inf", "empty", "half", "size", "type", "late", "double", "no stamp", "killed"]
    )
    burst = depth.copy()
    burst[depth.shape[0] // 2 :] = np.nan
    changed: dict[str, Any] = {
        "nan": burst,
        "inf": np.full_like(depth, -np.inf),
        "empty": np.zeros_like(depth),
        "half": np.where(np.arange(depth.shape[1]) < depth.shape[1] // 2, depth, 0),
        "size": depth[:, :-5],
        "type": depth.astype(np.float64),
    }
    data = changed.get(kind, depth)
    return (
        kind,
        data.astype(np.float32) if kind == "half" else data,
        *_stamp_fault(kind, stamp, shift),
    )


def _stamp_fault(kind: str, stamp: float, shift: float) -> tuple[Any, float]:
    """The stamp that is sent, and by how much the sensor's clock is off from now on."""
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


_STOPPED_BY_SIGNALS = """
import random, signal, sys, threading, time
import numpy as np
from runtime import Predictor, PushStream

chance = random.Random(int(sys.argv[1]))
predictor = Predictor("ssdnet-nano", threads=1)
rgb, depth = np.zeros((64, 96, 3), np.uint8), np.ones((64, 96), np.float32)
signal.signal(signal.SIGALRM, lambda *_: stopped.append(True))
for _ in range(20):
    on_result, stopped = chance.choice([None, lambda result: None]), []
    stream = PushStream(predictor, on_result=on_result, max_wait_ms=0)
    number, read = 0, chance.choice(["counts", "statistics", "state", "close_elsewhere"])
    signal.setitimer(signal.ITIMER_REAL, chance.uniform(0.001, 0.05))
    while not stopped:
        stream.push_image(rgb, number / 10)
        stream.push_depth(depth, number / 10)
        number += 1
        if read == "close_elsewhere":
            threading.Thread(target=stream.close).start()
        else:
            getattr(stream, read)
    stream.close()
    assert stream.counts.pending == 0, stream.counts
    assert stream.counts.pushed == 2 * number, stream.counts
stream = PushStream(predictor, max_wait_ms=0)
stream.push_image(np.zeros((375, 1242, 3), np.uint8), 0)
time.sleep(chance.uniform(0, 0.05))
"""


def soak_signals(*, rounds: int, seed: int) -> list[str]:
    """Run programs that signals interrupt; a line for each that failed."""
    found = []
    for number in range(seed, seed + rounds):
        try:
            subprocess.run(
                [sys.executable, "-c", _STOPPED_BY_SIGNALS, str(number)],
                check=True,
                capture_output=True,
                text=True,
                timeout=120,
            )
        except subprocess.TimeoutExpired:
            found.append(f"the program of seed {number} hangs")
        except subprocess.CalledProcessError as error:
            found.append(f"seed {number}: exit code {error.returncode}: {error.stderr[-200:]}")
    return found


#: Fault -> what it does to a file, given its content and a source of chance.
_DAMAGES: dict[str, Callable[[Path, bytes, random.Random], object]] = {
    "truncated": lambda path, old, chance: path.write_bytes(old[: chance.randrange(len(old))]),
    "overwritten": lambda path, old, chance: path.write_bytes(
        old[: (at := chance.randrange(len(old)))] + chance.randbytes(64) + old[at + 64 :]
    ),
    "random": lambda path, old, chance: path.write_bytes(chance.randbytes(len(old))),
    "pipe": lambda path, old, chance: (path.unlink(), os.mkfifo(path)),
    "device": lambda path, old, chance: (path.unlink(), path.symlink_to("/dev/zero")),
    "link loop": lambda path, old, chance: (path.unlink(), path.symlink_to(path)),
    "folder": lambda path, old, chance: (path.unlink(), path.mkdir()),
}
_SOURCE_BYTES, _SOURCE_TIMEOUT_S = 8 << 30, 30


def soak_sources(*, rounds: int, seed: int) -> list[str]:
    """Read damaged copies of the bundled recording; a line for each that was read wrongly."""
    chance, found = random.Random(seed), []
    originals = dict(enumerate(bundled_frames()[:3]))

    def hang(number: int, frame: object) -> None:
        raise TimeoutError(f"not read within {_SOURCE_TIMEOUT_S} s")

    before, limits = signal.signal(signal.SIGALRM, hang), resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_SOURCE_BYTES, limits[1]))
    try:
        for number in range(rounds):
            with tempfile.TemporaryDirectory() as folder:
                copies = [Path(folder) / kind for kind in ("rgb", "depth")]
                for copy, original in zip(copies, bundled_stream(), strict=True):
                    copy.mkdir()
                    for path in sorted(original.iterdir())[: len(originals)]:
                        shutil.copy(path, copy)
                damaged = chance.choice([path for copy in copies for path in copy.iterdir()])
                fault = chance.choice(list(_DAMAGES))
                _DAMAGES[fault](damaged, damaged.read_bytes(), chance)
                signal.alarm(_SOURCE_TIMEOUT_S)
                try:
                    _read_others(*copies, originals, damaged.stem)
                except Exception as error:
                    found.append(f"source {number}, {damaged.name} {fault}: {error!r}")
                finally:
                    signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, limits)
    return found


def _read_others(rgb: Path, depth: Path, originals: dict[int, Frame], damaged: str) -> None:
    """Read all frames; the one that is damaged may be an InputError."""
    with open_source("folders", rgb, depth=depth) as source:
        for index, listed in enumerate(source.list_frames()):
            if listed.name == damaged:
                with contextlib.suppress(InputError):
                    source.read(listed)
                continue
            frame = source.read(listed)
            np.testing.assert_array_equal(frame.rgb, originals[index].rgb)
            np.testing.assert_array_equal(frame.sparse_depth, originals[index].sparse_depth)


def resident_mb() -> float:
    """Memory of this process that is in use (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def resized_frames(size: tuple[int, int]) -> list[Frame]:
    """The bundled stream at another size."""
    return [
        Frame(
            Message(data=cv2.resize(frame.rgb, size[::-1])),
            Message(data=move_returns(frame.sparse_depth, size)),
        )
        for frame in bundled_frames()
    ]


def main() -> None:
    """Soak and print the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="of the live part")
    parser.add_argument("--rounds", type=int, default=20, help="of each other part")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--load", type=float, default=1.5, help="rate over what the model reaches")
    parser.add_argument("--size", default="375x1242", help="HEIGHTxWIDTH")
    parser.add_argument("--model", help="bundled name or path")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    dedicate_process()
    height, width = (int(side) for side in arguments.size.split("x"))
    frames = resized_frames((height, width))
    with Predictor(arguments.model, threads=arguments.threads) as predictor:
        predictor.warm_up((height, width), runs=3)
        times_ms = [
            predictor.predict(frame.rgb, frame.sparse_depth).latency.total_ms for frame in frames
        ]
        period_s = float(np.median(times_ms)) / 1e3 / arguments.load
        end = time.monotonic() + arguments.minutes * 60
        soaked = soak(
            predictor,
            frames,
            period_s=period_s,
            go_on=lambda number: time.monotonic() < end,
            seed=arguments.seed,
        )
    problems = soak_signals(rounds=arguments.rounds, seed=arguments.seed)
    problems += soak_sources(rounds=arguments.rounds, seed=arguments.seed)
    assert soaked.counts is not None
    assert soaked.statistics is not None
    print(f"pushed at {1 / period_s:.1f} Hz a sensor for {arguments.minutes:g} min")
    for name, counts in (("image", soaked.counts.images), ("depth", soaked.counts.depths)):
        print(
            f"{name}: {counts.pushed} pushed = {counts.answered} answered + dropped "
            f"{dict(counts.dropped)} + unmatched {dict(counts.unmatched)} + errors "
            f"{dict(counts.errors)} + {counts.pending} pending"
        )
    print(
        f"camera only {soaked.counts.camera_only}, jumps back {soaked.counts.jumps_back}, "
        f"not valid {soaked.invalid}"
    )
    print(f"faults: {dict(soaked.faults)}\nwatchdog: {dict(soaked.levels)}")
    print(soaked.statistics.table())
    memory = soaked.resident_mb or [0.0]
    print(
        f"resident MB: first {memory[0]:.0f}, after a fifth {memory[len(memory) // 5]:.0f}, "
        f"last {memory[-1]:.0f}, most {max(memory):.0f}"
    )
    if problems := soaked.problems() + problems:
        sys.exit("; ".join(problems))
    print(
        f"every message is accounted for; {arguments.rounds} programs with signals ended well, "
        f"{arguments.rounds} damaged sources were read or refused"
    )


if __name__ == "__main__":
    main()
