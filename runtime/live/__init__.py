"""Streams of sensors that push from their own threads, and the replay of recordings."""
