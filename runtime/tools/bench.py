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
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from itertools import product
from typing import TypeVar

import numpy as np

from runtime.command import SIGNALS
from runtime.io.engine_facts import MachineFacts, machine_facts
from runtime.session import import_onnxruntime
from runtime.sync.latency import LatencyStatistics, latency_statistics
from runtime.tools.bench_worker import Opened, open_model, time_model

_WARM_UP = 2  # runs of each model
_Answer = TypeVar("_Answer")


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
    """Figures of a model's runs."""

    latency: LatencyStatistics
    min_ms: float
    processor_ms: float  # median
    ratio: tuple[float, ...] | None  # of each run to `reference`'s: quartiles


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
    ratios = [mine / its for mine, (its, _) in zip(latencies, first.times_ms, strict=False)]
    return Figures(
        latency=statistics_ms,
        min_ms=min(latencies),
        processor_ms=statistics.median(worked),
        ratio=tuple(np.quantile(ratios, (0.25, 0.5, 0.75)).tolist()) if ratios else None,
    )


def _measure(group: Sequence[BenchRow], options: BenchOptions) -> None:
    """Open the models of a group, then run them in turn."""
    rounds, period_s, most = options.rounds, None, 1
    if options.rate_hz is not None:
        period_s, most = 1 / options.rate_hz, max(2, math.ceil(options.rate_hz))
    with contextlib.ExitStack() as stack:
        workers = []
        for row in group:
            executor = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
            workers.append((row, stack.enter_context(executor)))
            with _ignored_signals():
                opening = executor.submit(
                    open_model, row.model, row.size, row.batch, row.threads, options.provider
                )
            row.opened = _result(row, opening)
        for row, executor in workers:
            _run(row, executor, _WARM_UP, period_s)
        for at in range(0, rounds, most):
            for row, executor in workers:
                row.times_ms += _run(row, executor, min(most, rounds - at), period_s)


@contextlib.contextmanager
def _ignored_signals() -> Iterator[None]:
    """Let a process that is started in the block ignore Ctrl-C, which is for the command alone."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(
    row: BenchRow, executor: Executor, frames: int, period_s: float | None
) -> list[tuple[float, float]]:
    """Return the times of `time_model`; none after a failure."""
    if row.error is not None:
        return []
    return _result(row, executor.submit(time_model, frames, period_s)) or []


def _result(row: BenchRow, future: Future[_Answer]) -> _Answer | None:
    """Return the answer of a process; None after a failure, which is noted in the row."""
    try:
        return future.result()
    except BrokenProcessPool:
        row.error = "its process ended, most likely because it ran out of memory"
    except Exception as error:
        row.error = str(error)
    row.times_ms.clear()
    return None
