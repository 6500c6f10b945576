"""Metrics, scores of a network on whole sets, and the baselines it has to beat."""
