"""`ssdnet-bench`: models side by side on this machine."""

import math
import re
from typing import Annotated

import typer

from runtime.checks import check_number, shown
from runtime.command import (
    ERROR,
    INTERRUPTED,
    Provider,
    interruptible,
    print_result,
    reported_errors,
)
from runtime.command_options import Version
from runtime.cores import available_cores
from runtime.tools.bench import BenchOptions, BenchReport, BenchRow, bench, reference

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    "bench",
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
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Frames arrive at this rate; the models take turns of one second, and the "
            "latency is measured from when a frame is due. [default: turns of one run]",
        ),
    ] = None,
    provider: Annotated[
        Provider, typer.Option(help="Execution provider of the models.")
    ] = Provider.cpu,
    _version: Version = False,
) -> None:
    """Measure latency, memory and load time of models side by side."""
    if rate is not None:
        check_number("--rate", rate, 1e-3, 1e6, error=typer.BadParameter)
    cases = tuple(map(_size, size)), tuple(threads or [available_cores()]), tuple(batch)
    options = BenchOptions(tuple(models), *cases, rounds, rate, provider.value)
    with reported_errors("cpu"):
        with interruptible():
            report = bench(options)
        printed = print_result(to_markdown(report))
        if report.interrupted:
            raise typer.Exit(INTERRUPTED)
        failed = any(row.error for group in report.groups for row in group)
        raise typer.Exit(ERROR if failed or not printed else 0)


def _size(text: str) -> tuple[int, int]:
    sides = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.ASCII | re.IGNORECASE)
    if sides is None:
        raise typer.BadParameter(f"--size is HEIGHTxWIDTH, as 375x1242, got {shown(text)}")
    return int(sides[1]), int(sides[2])


def to_markdown(report: BenchReport) -> str:
    """A line on the machine, and a table for each size, threads and batch."""
    options, machine = report.options, report.machine
    how = "runs in turn" if options.rate_hz is None else f"frames at {options.rate_hz:g} Hz"
    parts = [
        f"{machine.processor}, {machine.logical_cores} logical cores, load {report.load:.2f} "
        f"at the start, onnxruntime {report.onnxruntime} on {options.provider}, Python "
        f"{machine.python}; {options.rounds} {how}{', interrupted' * report.interrupted}"
    ]
    for group in report.groups:
        titles = ["model", "input", "median ms", "min ms", "p99 ms"]
        titles += [f"ratio to {reference(group).model}", "quartiles", "processor ms"]
        titles += ["peak MB", "load ms", "first ms", "note"]
        rows = [titles, ["---"] * len(titles), *map(_cells, group)]
        lines = [f"| {' | '.join(map(_cell, row))} |" for row in rows]
        parts.append(f"**{_case(group[0])}**\n\n" + "\n".join(lines))
    return "\n\n".join(parts)


def _case(row: BenchRow) -> str:
    return f"{row.size[0]} x {row.size[1]}, threads {row.threads}, batch {row.batch}"


def _cells(row: BenchRow) -> list[str]:
    opened, found = row.opened, row.figures
    if opened is None or found is None:
        return [row.model, *["-"] * 10, row.error or "not measured"]
    low, ratio, high = found.ratio or (None, None, None)
    return [
        row.model,
        "x".join(map(str, next(iter(opened.shapes.values()), ()))),
        _number(found.latency.median_ms),
        _number(found.min_ms),
        _number(found.latency.p99_ms),
        _number(ratio),
        f"{_number(low)} to {_number(high)}",
        _number(found.processor_ms),
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
