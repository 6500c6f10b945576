"""`ssdnet-eval`, also as `python -m training.evaluation`."""

from runtime.command import end_quietly


def main() -> None:
    """Entry point of the command."""
    end_quietly()
    from training.evaluation.cli import app

    app()


if __name__ == "__main__":
    main()
