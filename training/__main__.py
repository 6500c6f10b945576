"""`ssdnet-train`, also as `python -m training`."""

from runtime.command import end_quietly


def main() -> None:
    """Entry point of the command."""
    end_quietly()
    from training.cli import app

    app()


if __name__ == "__main__":
    main()
