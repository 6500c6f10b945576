"""`ssdnet-eval`, also as `python -m training.evaluation`."""

from runtime.command.process import command_in

main = command_in("training.evaluation.cli")

if __name__ == "__main__":
    main()
