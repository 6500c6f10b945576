"""Recipes that ship with the project; `registry` has their names."""
