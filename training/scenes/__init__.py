"""Driving scenes made by the project: street layout, shapes, ray casting, shading, writing."""
