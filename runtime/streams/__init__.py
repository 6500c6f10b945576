"""Frames answered in their order: of sensors that push, of recordings, of ssdnet-run."""
