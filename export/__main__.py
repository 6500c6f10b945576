"""`ssdnet-export`, also as `python -m export`."""

from runtime.command.process import command_in

main = command_in("export.cli")

if __name__ == "__main__":
    main()
