"""The engine: a model file answers a frame."""
