"""Data sets in their real layouts, in small files whose right readings can be told by hand.

`magnify` repeats every pixel that often in both directions, for tests that need larger frames.
"""
