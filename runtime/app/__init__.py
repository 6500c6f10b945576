"""The commands: ssdnet-run, its outputs and pictures, and the tools."""
