"""`ssdnet-run`: the command line of `runtime.app.run.run`."""

import contextlib
from typing import Any

import typer

from runtime.app.run.options import RunOptions
from runtime.app.run.pipeline import OnRecord
from runtime.app.run.run import run
from runtime.app.run.run_report import describe_run, list_results
from runtime.command.options import GroupedCommand, read_options, with_options
from runtime.command.process import print_result, progress_bar, reported_errors

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    cls=GroupedCommand,
    epilog="Exit codes: 0 done; 1 error; 2 usage; 3 finished, but frames were skipped, answers "
    "were invalid, the LiDAR returns or the poses are implausible, or the run was stopped by "
    "Ctrl-C, SIGTERM or SIGHUP; 4 --deadline-ms or --deadline-p99-ms was missed; 5 a reason of "
    "--fail-on was found; 130 stopped by Ctrl-C, SIGTERM or SIGHUP before the first frame. If "
    "several apply, 5 comes before 4, and 4 before 3.",
)
@with_options(RunOptions)
def main(**given: Any) -> None:
    """Predict classes, depth and boundaries of every frame of a stream, and report the latency.

    Images and depth maps or scans in folders are paired by their stems, in natural order.
    """
    with reported_errors("cpu"), contextlib.ExitStack() as progress:
        options = read_options(RunOptions, given)

        def start(about: str, frames: int) -> OnRecord:
            progress.close()  # closes the bar of the camera before
            print_result(about)
            advance = progress.enter_context(progress_bar(frames, "frames"))
            return lambda record: advance()

        done = run(options, on_start=start)
        progress.close()
        print_result("\n".join([describe_run(done), *list_results(done)]))
        raise typer.Exit(done.exit_code)
