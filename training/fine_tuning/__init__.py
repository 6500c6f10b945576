"""Trainings that begin with weights: own folders with labels, and recordings without them."""
