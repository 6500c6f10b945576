"""Entry points of the commands; each imports only its own module."""

from collections.abc import Callable
from importlib import import_module

from runtime.command.process import begin_command


def _command(module: str) -> Callable[[], None]:
    """The entry point of the command whose `app` is in this module."""

    def start() -> None:
        begin_command()
        import_module(f"runtime.app.{module}").app()

    return start


run = _command("run.cli")
info, doctor, verify, bench, calibrate = map(
    _command,
    ("tools.info", "tools.doctor", "tools.verify", "tools.bench", "tools.calibrate"),
)
