"""`ssdnet-run`, also as `python -m runtime.run`."""

from runtime.command import begin_command


def main() -> None:
    """Entry point of the command."""
    begin_command()
    from runtime.run.cli import app

    app()


if __name__ == "__main__":
    main()
