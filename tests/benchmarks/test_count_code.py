from count_code import count_lines


def test_blank_lines_comments_and_docstrings_are_not_counted() -> None:
    source = '''"""A module."""

import os  # counted, with its comment


# not counted
def name() -> str:
    """Two lines
    of a docstring."""
    return (
        """a string
that is code"""
    )
'''
    assert count_lines(source) == 6
