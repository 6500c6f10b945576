"""`ssdnet-export`, also as `python -m export`."""

from runtime.command import end_quietly


def main() -> None:
    """Entry point of the command."""
    end_quietly()
    from export.cli import app

    app()


if __name__ == "__main__":
    main()
