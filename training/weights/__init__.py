"""Checkpoints that are installed with the package, see `training.weights.initial_weights`."""
