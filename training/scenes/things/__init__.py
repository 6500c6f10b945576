"""Shapes: meshes of houses, vehicles, people, plants, furniture and the ground."""
