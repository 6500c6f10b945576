"""Metrics, scores of models on whole sets, and the classical methods of depth completion."""
