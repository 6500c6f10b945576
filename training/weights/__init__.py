"""Checkpoints that are installed with the package, see `training.initial_weights`."""
