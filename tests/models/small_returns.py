"""Returns on a small image, whose grid of cells is small enough to count by hand."""

import numpy as np
import torch

from models.surfaces import MIN_DEPTH, SparseDepth

SIZE, GRID = (128, 192), (32, 48)
RANGE_M = 200.0
# A near and a far return in one cell, and the index of the cell.
TWO = {(40, 40): 0.05, (41, 41): 0.8}
CELL_OF_TWO = (0, 0, 10, 10)


def sparse_of(depth):
    """The returns of a map of normalised depth."""
    mask = (depth > 0).float()
    return SparseDepth(depth, mask, mask / depth.clamp(min=MIN_DEPTH))


def returns_at(returns):
    """Returns at (row, column) of a normalised depth."""
    depth = torch.zeros(1, 1, *SIZE)
    for place, value in returns.items():
        depth[(0, 0, *place)] = value
    return sparse_of(depth)


def scan_lines(lines, value=0.2):
    """A depth at every second column of every `lines`-th row."""
    depth = torch.zeros(1, 1, *SIZE)
    depth[..., ::lines, ::2] = value
    return sparse_of(depth)


def road():
    """The inverse depth of a tilted plane at every pixel, and its returns in some lines."""
    rows = torch.arange(SIZE[0]).float().view(1, 1, -1, 1).expand(1, 1, *SIZE)
    inverse, mask = 2 + 0.1 * rows, scan_lines(8).mask
    return inverse, SparseDepth(mask / inverse, mask, mask * inverse)


def random_depth(seed, share):
    rng = np.random.default_rng(seed)
    taken = torch.from_numpy(rng.random(SIZE) < share)
    return torch.from_numpy(rng.uniform(0.02, 0.9, SIZE).astype(np.float32)) * taken


def grid_of(value):
    return torch.full((1, 1, *GRID), value)
