"""`ssdnet-bench`: models side by side on this machine.

Each model runs in a process of its own, and so has its own memory and load time. The models take
turns, so that a disturbance affects all alike. Waiting threads do not spin
(`runtime.engine.session`), because they would take the cores of the model whose turn it is.
"""

import contextlib
import math
import multiprocessing
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from itertools import product
from typing import Annotated, Any

import numpy as np
import typer

from runtime.app.tools.bench_worker import OpenedModel, open_for_timing, time_model
from runtime.base.arguments import shown
from runtime.command.machine import MachineFacts, machine_facts
from runtime.command.options import Provider, Version
from runtime.command.process import (
    ERROR,
    INTERRUPTED,
    leave_signals_to_parent,
    print_result,
    reported_errors,
    stop_requested,
)
from runtime.engine.cores import available_cores
from runtime.engine.session import import_onnxruntime
from runtime.streams.statistics import LatencyStatistics, latency_statistics

_WARM_UP = 2  # runs of each model

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    epilog="Exit codes: 0 done; 1 a model could not run, its row says why; 2 usage; "
    "130 interrupted, after printing the results so far.",
)
def main(
    models: Annotated[
        list[str],
        typer.Argument(metavar="MODEL", help="Names of bundled models, or paths of ONNX files."),
    ],
    size: Annotated[
        list[str],
        typer.Option(
            metavar="HxW", help="Image size, for models with a free size; may be repeated."
        ),
    ] = ["375x1242"],  # noqa: B006 - typer copies it
    threads: Annotated[
        list[int] | None,
        typer.Option(
            min=1, help="Threads of inference; may be repeated. [default: physical cores]"
        ),
    ] = None,
    batch: Annotated[
        list[int],
        typer.Option(min=1, help="Batch size, for models with a free batch size; may be repeated."),
    ] = [1],  # noqa: B006
    rounds: Annotated[
        int, typer.Option(min=1, help="Measured runs of each model; p99 needs 100.")
    ] = 100,
    provider: Annotated[
        Provider, typer.Option(help="Execution provider of the models.")
    ] = Provider.cpu,
    _version: Version = False,
) -> None:
    """Measure latency, memory and load time of models side by side."""
    cases = tuple(map(_size, size)), tuple(threads or [available_cores()]), tuple(batch)
    with reported_errors("cpu"):
        with stop_requested(interrupts=True):
            report = bench(BenchOptions(tuple(models), *cases, rounds, provider.value))
        print_result(to_markdown(report))
        if report.interrupted:
            raise typer.Exit(INTERRUPTED)
        failed = any(row.error for group in report.groups for row in group)
        raise typer.Exit(ERROR if failed else 0)


def _size(text: str) -> tuple[int, int]:
    sides = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.ASCII | re.IGNORECASE)
    if sides is None:
        raise typer.BadParameter(f"--size is HEIGHTxWIDTH, as 375x1242, got {shown(text)}")
    return int(sides[1]), int(sides[2])


@dataclass(frozen=True)
class BenchOptions:
    """What is measured."""

    models: tuple[str, ...]  # bundled names and ONNX files; ratios refer to the first that ran
    sizes: tuple[tuple[int, int], ...]  # (height, width), for models with a free size
    threads: tuple[int, ...]  # within an operator
    batches: tuple[int, ...] = (1,)  # frames per run, for models with a free batch
    rounds: int = 100  # measured runs of each model
    provider: str = "cpu"


@dataclass
class BenchRow:
    """A model at a size, with its threads and frames per run: its times, or why there are none."""

    model: str
    size: tuple[int, int]
    threads: int
    batch: int
    opened: OpenedModel | None = None
    error: str | None = None
    times_ms: list[float] = field(default_factory=list)  # one for each run

    @property
    def latency(self) -> LatencyStatistics | None:
        """Statistics of the runs; None if there were none."""
        return latency_statistics(self.times_ms)


@dataclass
class BenchReport:
    """The outcome, with a group of rows, which took turns, for each size, threads and batch."""

    options: BenchOptions
    machine: MachineFacts
    onnxruntime: str
    groups: list[list[BenchRow]] = field(default_factory=list)
    interrupted: bool = False


def bench(options: BenchOptions) -> BenchReport:
    """Measure all models; KeyboardInterrupt ends the measurement and keeps what was measured.

    Raises:
        ProviderError: if ONNX Runtime is not installed.
    """
    report = BenchReport(options, machine_facts(), import_onnxruntime().__version__)
    try:
        for case in product(options.sizes, options.threads, options.batches):
            group = [BenchRow(model, *case) for model in options.models]
            report.groups.append(group)
            _measure(group, options)
    except KeyboardInterrupt:
        report.interrupted = True
    return report


def _measure(group: Sequence[BenchRow], options: BenchOptions) -> None:
    """Open the models of a group, then run them in turn."""
    with contextlib.ExitStack() as stack:
        workers = []
        for row in group:
            executor = ProcessPoolExecutor(
                1, multiprocessing.get_context("spawn"), initializer=leave_signals_to_parent
            )
            workers.append((row, stack.enter_context(executor)))
            case = row.model, row.size, row.batch, row.threads, options.provider
            row.opened = _answer(row, executor, open_for_timing, *case)
        for row, executor in workers:
            _answer(row, executor, time_model, _WARM_UP)
        for _ in range(options.rounds):
            for row, executor in workers:
                row.times_ms += _answer(row, executor, time_model, 1) or []


def _answer(row: BenchRow, executor: Executor, call: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in the process of a row; a failure is noted in the row and gives None."""
    if row.error is not None:
        return None
    try:
        return executor.submit(call, *arguments).result()
    except BrokenProcessPool:
        row.error = "its process ended, most likely because it ran out of memory"
    except Exception as error:
        row.error = str(error)
    row.times_ms.clear()
    return None


def to_markdown(report: BenchReport) -> str:
    """One line on the machine, and a table for each size, number of threads and batch."""
    options, machine = report.options, report.machine
    parts = [
        f"{machine.processor}, {machine.logical_cores} logical cores, load {machine.load:.2f} "
        f"at the start, onnxruntime {report.onnxruntime} on {options.provider}, Python "
        f"{machine.python}; {options.rounds} runs in turn{', interrupted' * report.interrupted}"
    ]
    for group in report.groups:
        first = next((row for row in group if row.times_ms), group[0])
        titles = ["model", "input", "median ms", "p99 ms", f"ratio to {first.model}", "quartiles"]
        titles += ["peak MB", "load ms", "first ms", "note"]
        rows = [titles, ["---"] * len(titles), *(_cells(row, first) for row in group)]
        lines = [f"| {' | '.join(map(_cell, row))} |" for row in rows]
        case = f"{first.size[0]} x {first.size[1]}, threads {first.threads}, batch {first.batch}"
        parts.append(f"**{case}**\n\n" + "\n".join(lines))
    return "\n\n".join(parts)


def _cells(row: BenchRow, first: BenchRow) -> list[str]:
    opened, latency = row.opened, row.latency
    if opened is None or latency is None:
        return [row.model, *["-"] * 8, row.error or "not measured"]
    # Ctrl-C can end the measurement within a round.
    ratios = [mine / its for mine, its in zip(row.times_ms, first.times_ms, strict=False)]
    low, ratio, high = map(_number, np.quantile(ratios, (0.25, 0.5, 0.75)))
    return [
        row.model,
        "x".join(map(str, next(iter(opened.shapes.values()), ()))),
        _number(latency.median_ms),
        _number(latency.p99_ms),
        ratio,
        f"{low} to {high}",
        _number(opened.peak_memory_mb),
        _number(opened.load_ms),
        _number(opened.first_inference_ms),
        ", ".join(opened.notes),
    ]


def _number(value: float | None) -> str:
    """Three significant digits or more; "-" for None."""
    if value is None:
        return "-"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value or 1)))}f}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
