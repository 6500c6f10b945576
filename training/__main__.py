"""The entry points of the commands that train; `python -m training` is `ssdnet-train`."""

from runtime.command.process import command_in

train, finetune, adapt = (
    command_in(f"training.commands.{name}") for name in ("train", "finetune", "adapt")
)

if __name__ == "__main__":
    train()
