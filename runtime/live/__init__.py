"""Frames pushed by a driving stack's own callbacks: synchronised, answered, accounted for."""
