"""Metrics, scores of models on whole sets, and classical methods of depth completion."""
