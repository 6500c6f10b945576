"""Streams: sensors push from their own threads; frames are matched, predicted and counted."""
