"""`ssdnet-export`, also as `python -m export`."""

from runtime.command.process import begin_command


def main() -> None:
    """Entry point of the command."""
    begin_command()
    from export.cli import app

    app()


if __name__ == "__main__":
    main()
