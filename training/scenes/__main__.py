"""`ssdnet-render`, also as `python -m training.scenes`."""

from runtime.command import end_quietly


def main() -> None:
    """Entry point of the command."""
    end_quietly()
    from training.scenes.cli import app

    app()


if __name__ == "__main__":
    main()
