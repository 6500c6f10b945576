"""The entry points of the commands that train; `python -m training` is `ssdnet-train`."""

from collections.abc import Callable
from importlib import import_module

from runtime.command.process import begin_command


def _command(name: str) -> Callable[[], None]:
    """Return the entry point of a command, which imports only its own file."""

    def start() -> None:
        begin_command()
        import_module(f"training.commands.{name}").app()

    return start


train, finetune, adapt = map(_command, ("train", "finetune", "adapt"))

if __name__ == "__main__":
    train()
