"""`ssdnet-run`, also as `python -m runtime.run`."""

from runtime.command import end_quietly


def main() -> None:
    """Entry point of the command."""
    end_quietly()
    from runtime.run.cli import app

    app()


if __name__ == "__main__":
    main()
