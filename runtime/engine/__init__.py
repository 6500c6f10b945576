"""The engine, which runs a model file on frames."""
