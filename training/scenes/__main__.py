"""`ssdnet-render`, also as `python -m training.scenes`."""

from runtime.command.process import command_in

main = command_in("training.scenes.cli")

if __name__ == "__main__":
    main()
