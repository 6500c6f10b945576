"""Every classical method, on frames as they are recorded and on damaged ones."""

import numpy as np
import pytest

from runtime.base.errors import InputError, SSDNetError
from training.evaluation.classical import METHODS
from training.evaluation.open_model import method_predict, open_method

FILLS_EVERYTHING = ("nearest", "linear", "planes", "mrf", "tgv")


@pytest.fixture(params=METHODS)
def name(request):
    return request.param


def frame(height=40, width=50, share=0.1):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    depth = rng.uniform(3, 60, (height, width)).astype(np.float32)
    depth[rng.random((height, width)) > share] = 0
    return rgb, depth


def complete(name, rgb, sparse_depth):
    """The depth as it is scored."""
    return open_method(name).predict(rgb, sparse_depth, 700.0).depth


@pytest.mark.parametrize("size", [(40, 50), (33, 47), (5, 7)])
def test_the_answer_is_depth_of_the_frames_size_and_nothing_else(name, size):
    rgb, sparse_depth = frame(*size)
    before = sparse_depth.copy()
    answer = open_method(name).predict(rgb, sparse_depth, None)
    assert list(answer.heads) == ["depth"]
    assert answer.depth.shape == size
    assert answer.depth.dtype == np.float32
    assert 0 < answer.depth.max() <= 100
    np.testing.assert_array_equal(sparse_depth, before)
    assert not np.shares_memory(answer.depth, sparse_depth)


def test_invalid_returns_change_nothing(name):
    rgb, sparse_depth = frame()
    clean = complete(name, rgb, sparse_depth)
    empty = np.flatnonzero(sparse_depth == 0)[:40]
    sparse_depth.flat[empty] = np.tile([np.nan, np.inf, -np.inf, -3.0, 250.0], 8)
    np.testing.assert_array_equal(complete(name, rgb, sparse_depth), clean)


def test_a_frame_without_returns_has_no_answer(name):
    rgb, _ = frame()
    for nothing in (0.0, np.nan, -1.0, 150.0):
        assert not complete(name, rgb, np.full((40, 50), nothing, np.float32)).any()


@pytest.mark.parametrize("at", [(20, 30), (0, 0), (59, 159)])
def test_one_return(name, at):
    sparse_depth = np.zeros((60, 160), np.float32)
    sparse_depth[at] = 12.5
    depth = complete(name, frame(60, 160)[0], sparse_depth)
    if name in FILLS_EVERYTHING:
        np.testing.assert_allclose(depth, 12.5, rtol=1e-4)
    elif name == "ip-basic":
        assert 0 < np.count_nonzero(depth) < depth.size
    else:  # to it, one return is noise, but in a corner
        assert depth.any() == (at != (20, 30))


def test_an_answer_that_is_not_finite_is_an_error():
    class Broken:
        def complete(self, rgb, sparse_depth):
            return np.full_like(sparse_depth, np.nan)

    with pytest.raises(SSDNetError, match="Broken"):
        method_predict(Broken())(*frame(), None)


def test_an_unknown_method_names_the_known_ones():
    with pytest.raises(InputError, match=f"'magic'.*{', '.join(METHODS)}"):
        open_method("magic")
