"""Recipes that ship with the project: one TOML file a training."""
