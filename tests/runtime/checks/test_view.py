"""Where a scan jumps to something farther."""

import numpy as np

from runtime.checks.view import find_jumps


def scan(ranges):
    """Points on one line, 0.2 degrees apart, at these ranges."""
    angles = np.radians(0.2) * np.arange(len(ranges))
    return np.c_[np.sin(angles), np.full(len(angles), 0.1), np.cos(angles)] * np.c_[ranges]


def test_the_nearer_side_of_an_edge_is_a_jump_in_any_order():
    ranges = np.r_[np.full(20, 10.0), np.full(20, 20.0), np.linspace(20, 20.4, 20)]
    points = scan(ranges).astype(np.float32)
    found = np.flatnonzero(find_jumps(points))
    assert 17 <= found.min() <= found.max() == 19
    order = np.random.default_rng(0).permutation(len(points))
    assert sorted(order[find_jumps(points[order])]) == found.tolist()


def test_another_scan_line_is_no_neighbour():
    """The line above, 0.4 degrees away as in a LiDAR of 64 lines, has another range."""
    near, far = scan(np.full(40, 10.0)), scan(np.full(40, 30.0))
    far[:, 1] -= 30 * np.radians(0.4)
    assert not find_jumps(np.r_[near, far].astype(np.float32)).any()
