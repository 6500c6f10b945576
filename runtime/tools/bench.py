"""Models side by side on this machine.

Each runs in a process of its own, which gives it its own memory and load time. All take turns, so
that a disturbance affects all alike. Threads that wait do not spin (`runtime.session`): they would
take the cores of the model whose turn it is.
"""

import contextlib
import math
import multiprocessing
import os
import signal
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
from multiprocessing import resource_tracker
from typing import Any

import numpy as np

from runtime.command import SIGNALS, stop_requested
from runtime.io.engine_facts import MachineFacts, machine_facts
from runtime.session import import_onnxruntime
from runtime.sync.latency import LatencyStatistics, latency_statistics
from runtime.tools.bench_worker import Opened, serve

BENCH_FORMAT, BENCH_VERSION = "ssdnet-bench", "1.0"

_WARM_UP = 2  # runs of each model


@dataclass(frozen=True)
class BenchOptions:
    """What is measured."""

    models: tuple[str, ...]  # bundled names and ONNX files; ratios are to the first that ran
    sizes: tuple[tuple[int, int], ...]  # (height, width), of models of free size
    threads: tuple[int, ...]  # within an operator
    batches: tuple[int, ...] = (1,)  # frames of a run, of models of free batch
    rounds: int = 100  # measured runs of each model
    rate_hz: float | None = None  # of frames, for a second in turn; None = one run in turn
    provider: str = "cpu"


@dataclass(frozen=True)
class Figures:
    """Figures of a model's runs; a ratio is the quartiles of each run's to `reference`'s."""

    latency: LatencyStatistics
    min_ms: float
    processor_ms: float  # median
    ratio: tuple[float, ...] | None
    processor_ratio: tuple[float, ...] | None


@dataclass
class BenchRow:
    """A model at a size, with so many threads and frames a run: figures, or why there are none."""

    model: str
    size: tuple[int, int]
    threads: int
    batch: int
    opened: Opened | None = None
    error: str | None = None
    #: Latency and processor time of all threads, of each run.
    times_ms: list[tuple[float, float]] = field(default_factory=list)
    figures: Figures | None = None


@dataclass
class BenchReport:
    """The outcome: a group of rows, which took turns, for each size, threads and batch."""

    options: BenchOptions
    machine: MachineFacts
    onnxruntime: str
    load: float  # of the machine before the start
    groups: list[list[BenchRow]] = field(default_factory=list)
    interrupted: bool = False

    def document(self) -> dict[str, Any]:
        """Return the content of --json."""
        return {"format": BENCH_FORMAT, "version": BENCH_VERSION, **asdict(self)}


def bench(options: BenchOptions) -> BenchReport:
    """Measure all models; KeyboardInterrupt ends it with what was measured.

    Raises:
        ProviderError: if ONNX Runtime is not installed.
    """
    version, load = import_onnxruntime().__version__, round(os.getloadavg()[0], 2)
    report = BenchReport(options, machine_facts(), version, load)
    try:
        for case in product(options.sizes, options.threads, options.batches):
            group = [BenchRow(model, *case) for model in options.models]
            report.groups.append(group)
            _measure(group, options)
    except KeyboardInterrupt:
        report.interrupted = True
    for group in report.groups:
        for row in group:
            row.figures = _figures(row, reference(group))
    return report


def reference(group: Sequence[BenchRow]) -> BenchRow:
    """Return the row of a group that others are compared with: the first that ran."""
    return next((row for row in group if row.times_ms), group[0])


def _figures(row: BenchRow, first: BenchRow) -> Figures | None:
    latencies, worked = ([times[at] for times in row.times_ms] for at in (0, 1))
    statistics_ms = latency_statistics(latencies)
    if row.opened is None or statistics_ms is None:
        return None
    # Ctrl-C can end within a round.
    ratios = np.array(
        [np.divide(*pair) for pair in zip(row.times_ms, first.times_ms, strict=False)]
    )
    quartiles = np.quantile(ratios, (0.25, 0.5, 0.75), axis=0).T.tolist() if len(ratios) else None
    return Figures(
        latency=statistics_ms,
        min_ms=min(latencies),
        processor_ms=statistics.median(worked),
        ratio=quartiles and tuple(quartiles[0]),
        processor_ratio=quartiles and tuple(quartiles[1]),
    )


def _measure(group: Sequence[BenchRow], options: BenchOptions) -> None:
    """Open the models of a group, then run them in turn."""
    rounds, period_s, most = options.rounds, None, 1
    if options.rate_hz is not None:
        period_s, most = 1 / options.rate_hz, max(2, math.ceil(options.rate_hz))
    with contextlib.ExitStack() as stack:
        workers = []
        for row in group:
            with stop_requested() as stopped:  # a starting process cannot be terminated
                worker = _Worker(row, options)
                stack.callback(worker.end)
            if stopped():
                raise KeyboardInterrupt
            row.opened = worker.receive()
            workers.append(worker)
        for worker in workers:
            worker.run(_WARM_UP, period_s)
        for at in range(0, rounds, most):
            for worker in workers:
                worker.row.times_ms.extend(worker.run(min(most, rounds - at), period_s))


class _Worker:
    """A process that runs the model of a row; a failure is noted there."""

    def __init__(self, row: BenchRow, options: BenchOptions) -> None:
        self.row = row
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        request = {"model": row.model, "size": row.size, "threads": row.threads, "batch": row.batch}
        request |= {"provider": options.provider}
        self._process = context.Process(target=serve, args=(theirs,), kwargs=request)
        resource_tracker.ensure_running()  # otherwise `start` runs it, which unblocks signals
        # The process inherits the mask: Ctrl-C is for the command alone.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    def run(self, frames: int, period_s: float | None) -> list[tuple[float, float]]:
        """Return the times of `time_runs`; none after a failure."""
        if self.row.error is not None:
            return []
        with contextlib.suppress(OSError):  # the process has ended: `receive` reports it
            self._pipe.send((frames, period_s))
        return self.receive() or []

    def receive(self) -> Any:
        """Return the next answer of `serve`; None after a failure."""
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode
            answer = f"its process ended with exit code {code}"
            if code == -signal.SIGKILL:
                answer = "its process was killed, most likely because it ran out of memory"
        if not isinstance(answer, str):
            return answer
        self.row.error = answer
        self.row.times_ms.clear()
        return None

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._pipe.close()
        self._process.join()
