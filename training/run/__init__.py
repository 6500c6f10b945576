"""A run of a recipe: its loop, its state, its validations and its folder."""
