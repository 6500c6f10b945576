"""`ssdnet-eval`: scores of models, predictions and methods on the same frames, and differences."""

import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.command.json_file import STDOUT, write_json
from runtime.command.options import read_options, with_options
from runtime.command.process import print_result, reported_errors, stop_requested
from runtime.files.atomic_write import atomic_write
from training.evaluation.options import EvaluationOptions

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
# Characters of a line if the output is not a terminal.
_WIDTH = 120


@app.command()
@with_options(EvaluationOptions)
def evaluate(
    *,
    all_columns: Annotated[
        bool, typer.Option("--all", help="Print all figures instead of the main ones.")
    ] = False,
    **given: Any,
) -> None:
    """Score models on data sets.

    Prints a table, and for each model whether it differs from the first beyond chance.
    """
    with reported_errors("cpu,train"):
        options = read_options(EvaluationOptions, given)
        with stop_requested(interrupts=True):
            _score(options, all_columns=all_columns)


def _score(options: EvaluationOptions, *, all_columns: bool) -> None:
    """Score, print the tables, and write the files."""
    # Heavy imports are here, so that --help answers at once.
    from training.evaluation.adapter import MissingAdapterError
    from training.evaluation.evaluate import score_models
    from training.pages.page import write_page
    from training.scores.score_report import format_differences, format_table, list_figures

    try:
        found = score_models(options)
    except MissingAdapterError as error:
        print_result(error.text)
        raise
    if options.json != STDOUT:
        width = shutil.get_terminal_size((_WIDTH, 0)).columns
        text = format_table(found.rows, all_columns=all_columns, width=width)
        print_result(text + format_differences(found.differences, width=width))
        if found.draft:
            _print_draft(found.draft, options)
    document = list_figures(found.rows, found.differences)
    write_json(options.json, document, overwrite=options.overwrite)
    if options.page is not None:
        write_page(
            found.results,
            options.page,
            differences=found.differences,
            worst=found.worst,
            overwrite=options.overwrite,
        )


def _print_draft(groups: Mapping[str, Sequence[str]], options: EvaluationOptions) -> None:
    """Print a draft of --join, which is written beside a page, and the command that goes on."""
    from training.base.tables import to_toml

    page = options.page
    path = Path("join.toml") if page is None else page.with_suffix(".join.toml")
    alone = ", ".join(name for name, members in groups.items() if len(members) == 1)
    hint = f"# Add by hand what these mean in the models, or leave them: {alone}\n" if alone else ""
    text = f"{to_toml(groups)}\n{hint}"
    if page is not None:
        atomic_write(path, text.encode())
    done = "written to" if page is not None else "to be saved as"
    replaces = not options.overwrite and (page or options.json)
    further = ["--join", str(path), *(["--overwrite"] if replaces else [])]
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:], *further])
    print_result(
        f"\nSo few labels are scored because names differ. Classes that may mean the same, {done} "
        f"{path}; check them, and go on by\n{command}\n\n{text}"
    )
