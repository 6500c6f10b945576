import numpy as np

from flying_pixels import flies


def test_only_what_lies_between_two_surfaces_flies():
    truth = np.full((20, 40), 10, np.float32)
    truth[:, 20:] = 30
    depth = truth.copy()
    depth[5, 18] = 20  # between them, two pixels from the edge
    depth[5, 20] = 20  # at it
    depth[5, 10] = 20  # wrong, but no other surface is near
    depth[5, 35] = 20
    depth[9, 18] = 29  # on the far surface
    depth[9, 20] = 5  # nearer than both
    found = flies(depth, truth)
    assert sorted(zip(*np.nonzero(found), strict=True)) == [(5, 18), (5, 20)]
