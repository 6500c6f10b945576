"""`ssdnet-eval`, also as `python -m training.evaluation`."""

from runtime.command.process import begin_command


def main() -> None:
    """Entry point of the command."""
    begin_command()
    from training.evaluation.cli import app

    app()


if __name__ == "__main__":
    main()
