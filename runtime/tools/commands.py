"""Entry points of the commands; each imports only its own file."""

from runtime.command import begin_command


def info() -> None:
    """`ssdnet-info`."""
    begin_command()
    from runtime.tools.info import app

    app()


def doctor() -> None:
    """`ssdnet-doctor`."""
    begin_command()
    from runtime.tools.doctor_cli import app

    app()


def verify() -> None:
    """`ssdnet-verify`."""
    begin_command()
    from runtime.tools.verify_cli import app

    app()


def bench() -> None:
    """`ssdnet-bench`."""
    begin_command()
    from runtime.tools.bench_cli import app

    app()
