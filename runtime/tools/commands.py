"""Entry points of the commands; each imports only its own file."""

from runtime.command import end_quietly


def info() -> None:
    """`ssdnet-info`."""
    end_quietly()
    from runtime.tools.info import app

    app()


def doctor() -> None:
    """`ssdnet-doctor`."""
    end_quietly()
    from runtime.tools.doctor_cli import app

    app()


def verify() -> None:
    """`ssdnet-verify`."""
    end_quietly()
    from runtime.tools.verify_cli import app

    app()
