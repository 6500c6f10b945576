"""`ssdnet-render`, also as `python -m training.scenes`."""

from runtime.command.process import begin_command


def main() -> None:
    """Entry point of the command."""
    begin_command()
    from training.scenes.cli import app

    app()


if __name__ == "__main__":
    main()
