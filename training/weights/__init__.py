"""The weights with which a training begins, what changes weights, and the installed checkpoints."""
