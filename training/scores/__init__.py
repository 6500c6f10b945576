"""Scores of models on whole sets: metrics, rows, and differences between models."""
