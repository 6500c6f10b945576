"""`ssdnet-train`: from a recipe to a checkpoint."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.errors import SSDNetError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def train(
    recipe: Annotated[Path, typer.Argument(help="TOML file that says everything of a training.")],
    data: Annotated[
        list[Path], typer.Option(help="Folder with the recipe's data sets; may be repeated.")
    ],
    out: Annotated[
        Path, typer.Option(help="Run folder; one of the same recipe goes on where it stopped.")
    ],
    init: Annotated[
        Path | None, typer.Option(help="Checkpoint whose weights to start from.")
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a key of the recipe: 'schedule.steps = 500'."),
    ] = None,
    device: Annotated[str, typer.Option(help="'cpu', 'cuda' or 'cuda:N'.")] = "cpu",
    stop_after: Annotated[
        int | None, typer.Option(min=1, help="End at this step; the run can be resumed.")
    ] = None,
) -> None:
    """Train a network; writes checkpoints, TensorBoard curves and the resolved recipe."""
    try:
        # Heavy imports here, so that --help answers at once.
        from training.loop import train as run
        from training.recipe import read_recipe

        path = run(
            read_recipe(recipe, change or ()),
            data=data,
            out=out,
            init=init,
            device=device,
            stop_after=stop_after,
        )
    except ImportError as error:
        typer.echo(f'error: {error}: training needs pip install "ssdnet[train]"', err=True)
        raise typer.Exit(1) from error
    except SSDNetError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(1) from error
    except KeyboardInterrupt:
        kept = (out / "last.pt").is_file()
        typer.echo(
            "stopped; the same command goes on from the last checkpoint"
            if kept
            else "stopped before the first checkpoint; the same command starts anew",
            err=True,
        )
        raise typer.Exit(1) from None
    typer.echo(str(path))


def main() -> None:
    """Entry point of the installed command."""
    app()


if __name__ == "__main__":
    main()
