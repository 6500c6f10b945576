"""`ssdnet-bench`: models side by side on this machine.

Each model runs in a process of its own, and so has its own memory and load time. The models take
turns, so that a disturbance affects all alike. Waiting threads do not spin
(`runtime.engine.session`), because they would take the cores of the model whose turn it is.
"""

# ruff: noqa: RUF009 - what is called in `BenchOptions` returns a field

import contextlib
import math
import multiprocessing
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import MISSING, dataclass, field
from itertools import product
from typing import Any

import numpy as np
import typer

from runtime.app.tools.bench_worker import OpenedModel, open_for_timing, time_model
from runtime.base.arguments import shown
from runtime.command import process
from runtime.command.machine import machine_facts
from runtime.command.options import Provider, UsageError, option_group, read_options, with_options
from runtime.engine.cores import available_cores
from runtime.engine.session import import_onnxruntime
from runtime.streams.statistics import latency_statistics

_WARM_UP = 2  # runs of each model
_option = option_group()


def _sizes(texts: Sequence[str]) -> list[tuple[int, int]]:
    """The sizes as (height, width)."""
    sizes = []
    for text in texts:
        sides = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.ASCII | re.IGNORECASE)
        if sides is None:
            raise UsageError(f"--size is HEIGHTxWIDTH, as 375x1242, got {shown(text)}")
        sizes.append((int(sides[1]), int(sides[2])))
    return sizes


@dataclass(frozen=True)
class BenchOptions:
    """The options of `ssdnet-bench`. Ratios refer to the first model that ran."""

    models: list[str] = _option(
        "Names of bundled models, or paths of ONNX files.",
        default=MISSING,
        kind=typer.Argument,
        metavar="MODEL",
    )
    size: Sequence[tuple[int, int]] = _option(
        "Image size, for models with a free size; may be repeated. [default: 375x1242]",
        default=((375, 1242),),
        given=list[str] | None,
        read=_sizes,
        metavar="HxW",
    )
    threads: Sequence[int] = _option(
        "Threads of inference; may be repeated. [default: physical cores]",
        default=(),
        given=list[int] | None,
        min=1,
    )
    batch: Sequence[int] = _option(
        "Batch size, for models with a free batch size; may be repeated. [default: 1]",
        default=(1,),
        given=list[int] | None,
        min=1,
    )
    rounds: int = _option("Measured runs of each model; p99 needs 100.", default=100, min=1)
    provider: Provider = _option("Execution provider of the models.", default=Provider.cpu)


app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    epilog="Exit codes: 0 done; 1 a model could not run, its row says why; 2 usage; "
    "130 interrupted, after printing the results so far."
)
@with_options(BenchOptions)
def main(**given: Any) -> None:
    """Measure latency, memory and load time of models side by side."""
    with process.reported_errors("cpu"):
        options = read_options(BenchOptions, given)
        machine, groups, interrupted = machine_facts(), list[list[BenchRow]](), False
        onnxruntime = import_onnxruntime().__version__
        try:
            with process.stop_requested(interrupts=True):
                threads = options.threads or [available_cores()]
                for case in product(options.size, threads, options.batch):
                    groups.append([BenchRow(model, *case) for model in options.models])
                    _measure(groups[-1], options)
        except KeyboardInterrupt:
            interrupted = True
        about = (
            f"{machine.processor}, {machine.logical_cores} logical cores, load {machine.load:.2f} "
            f"at the start, onnxruntime {onnxruntime} on {options.provider}, Python "
            f"{machine.python}; {options.rounds} runs in turn{', interrupted' * interrupted}"
        )
        process.print_result("\n\n".join([about, *map(_table, groups)]))
        failed = any(row.error for group in groups for row in group)
        raise typer.Exit(process.INTERRUPTED if interrupted else process.ERROR * failed)


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


def _measure(group: Sequence[BenchRow], options: BenchOptions) -> None:
    """Open the models of a group, then run them in turn."""
    with contextlib.ExitStack() as stack:
        workers = []
        for row in group:
            context, deaf = multiprocessing.get_context("spawn"), process.leave_signals_to_parent
            executor = ProcessPoolExecutor(1, context, initializer=deaf)
            workers.append((row, stack.enter_context(executor)))
            case = row.model, row.size, row.batch, row.threads, options.provider.value
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


def _table(group: Sequence[BenchRow]) -> str:
    """The table of models that took turns, in Markdown."""
    first = next((row for row in group if row.times_ms), group[0])
    titles = ["model", "input", "median ms", "p99 ms", f"ratio to {first.model}", "quartiles"]
    titles += ["peak MB", "load ms", "first ms", "note"]
    rows = [titles, ["---"] * len(titles), *(_cells(row, first) for row in group)]
    lines = [f"| {' | '.join(map(_cell, row))} |" for row in rows]
    case = f"{first.size[0]} x {first.size[1]}, threads {first.threads}, batch {first.batch}"
    return "\n".join([f"**{case}**\n", *lines])


def _cells(row: BenchRow, first: BenchRow) -> list[str]:
    opened, latency = row.opened, latency_statistics(row.times_ms)
    if opened is None or latency is None:
        return [row.model, *["-"] * 8, row.error or "not measured"]
    # Ctrl-C can end the measurement within a round.
    ratios = [mine / its for mine, its in zip(row.times_ms, first.times_ms, strict=False)]
    low, ratio, high = map(_number, np.quantile(ratios, (0.25, 0.5, 0.75)))
    shape = "x".join(map(str, next(iter(opened.shapes.values()), ())))
    times = [_number(latency.median_ms), _number(latency.p99_ms), ratio, f"{low} to {high}"]
    costs = opened.peak_memory_mb, opened.load_ms, opened.first_inference_ms
    return [row.model, shape, *times, *map(_number, costs), ", ".join(opened.notes)]


def _number(value: float | None) -> str:
    """Three significant digits or more; "-" for None."""
    if value is None:
        return "-"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value or 1)))}f}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
