"""The commands of the engine: ssdnet-run with its outputs, and the tools."""
