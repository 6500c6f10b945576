"""Every method with the engine's face, on frames as they come and as they should not."""

import numpy as np
import pytest

from runtime.completion.ip_basic import IPBasic
from runtime.completion.methods import METHODS, create_method
from runtime.completion.predictor import CompletionPredictor
from runtime.errors import InputError
from runtime.prediction import DEPTH_INCOMPLETE, DEPTH_UNKNOWN, NO_DEPTH

FILLS_EVERYTHING = ("nearest", "mrf", "tgv")


@pytest.fixture(params=METHODS)
def name(request):
    if request.param == "mrf":
        pytest.importorskip("scipy.sparse")
    return request.param


def frame(height=40, width=50, share=0.1):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    depth = rng.uniform(3, 60, (height, width)).astype(np.float32)
    depth[rng.random((height, width)) > share] = 0
    return rgb, depth


@pytest.mark.parametrize("size", [(40, 50), (33, 47), (97, 32)])
def test_a_prediction_is_depth_of_the_frames_size_and_nothing_else(name, size):
    rgb, sparse_depth = frame(*size)
    before = sparse_depth.copy()
    with CompletionPredictor(name) as predictor:
        prediction = predictor.predict(rgb, sparse_depth, stamp="now")
    assert prediction.semantic is None
    assert prediction.boundary is None
    assert prediction.depth.shape == size
    assert prediction.depth.dtype == np.float32
    assert prediction.depth.max() <= 100
    assert prediction.frame_size == prediction.network_size == size
    assert prediction.depth_returns == np.count_nonzero(sparse_depth)
    assert prediction.valid
    assert prediction.stamp == "now"
    assert prediction.latency.total_ms >= prediction.latency.inference_ms > 0
    np.testing.assert_array_equal(sparse_depth, before)
    assert not np.shares_memory(prediction.depth, sparse_depth)
    assert (prediction.depth > 0).all() == (prediction.degraded == ())


def test_returns_that_are_none_change_nothing(name):
    rgb, sparse_depth = frame()
    clean = CompletionPredictor(name).predict(rgb, sparse_depth)
    empty = np.flatnonzero(sparse_depth == 0)[:40]
    sparse_depth.flat[empty] = np.tile([np.nan, np.inf, -np.inf, -3.0, 250.0], 8)
    prediction = CompletionPredictor(name).predict(rgb, sparse_depth)
    np.testing.assert_array_equal(prediction.depth, clean.depth)
    assert prediction.cleaned.total == 40
    assert prediction.cleaned.nan == 8


def test_a_frame_without_returns_has_no_answer(name):
    rgb, _ = frame()
    for nothing in (0.0, np.nan, -1.0, 150.0):
        prediction = CompletionPredictor(name).predict(rgb, np.full((40, 50), nothing, np.float32))
        assert not prediction.valid
        assert {NO_DEPTH, DEPTH_UNKNOWN} <= set(prediction.degraded)
        assert not prediction.depth.any()


@pytest.mark.parametrize("at", [(20, 30), (0, 0), (59, 199)])
def test_one_return(name, at):
    sparse_depth = np.zeros((60, 200), np.float32)
    sparse_depth[at] = 12.5
    rgb = frame(60, 200)[0]
    prediction = CompletionPredictor(name).predict(rgb, sparse_depth)
    if name in FILLS_EVERYTHING:
        np.testing.assert_allclose(prediction.depth, 12.5, rtol=1e-4)
        assert DEPTH_INCOMPLETE not in prediction.degraded
    elif name == "ip-basic":
        assert prediction.valid
        assert DEPTH_INCOMPLETE in prediction.degraded
        assert 0 < np.count_nonzero(prediction.depth) < prediction.depth.size
    else:  # to it, one return is noise, but in a corner
        assert prediction.valid == prediction.depth.any() == (at != (20, 30))


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (3, 2), (5, 5)])
def test_methods_themselves_take_the_smallest_frames(name, size):
    rgb = np.full((*size, 3), 100, np.uint8)
    sparse_depth = np.full(size, np.nan, np.float32)
    assert not create_method(name).complete(rgb, sparse_depth).any()
    sparse_depth.flat[0] = 8.0
    depth = create_method(name).complete(rgb, sparse_depth)
    assert depth.shape == size
    assert depth.dtype == np.float32
    assert np.isfinite(depth).all()
    if name in FILLS_EVERYTHING:
        np.testing.assert_allclose(depth, 8.0, rtol=1e-5)


def test_a_full_map_comes_back(name):
    rgb = np.full((40, 50, 3), 100, np.uint8)
    prediction = CompletionPredictor(name).predict(rgb, np.full((40, 50), 20, np.float32))
    np.testing.assert_allclose(prediction.depth[5:-5, 5:-5], 20, rtol=1e-4)


def test_the_range_is_the_callers():
    rgb, sparse_depth = frame()
    short = CompletionPredictor(IPBasic(max_depth_m=20.0), max_depth_m=20.0)
    assert short.contract.max_depth_m == 20
    prediction = short.predict(rgb, sparse_depth)
    assert prediction.cleaned.too_far == np.count_nonzero(sparse_depth > 20)
    assert prediction.depth.max() <= 20
    with pytest.raises(InputError, match="max_depth_m must be 1 to 10000"):
        CompletionPredictor("nearest", max_depth_m=0)


def test_the_warm_up_is_work_and_keeps_the_first_time():
    predictor = CompletionPredictor("nearest")
    assert predictor.first_inference_ms is None
    predictor.warm_up((40, 50), runs=2)
    assert predictor.first_inference_ms > 0


def test_an_unknown_method_names_the_known_ones():
    with pytest.raises(InputError, match="unknown method 'magic'; known: nearest, ip-basic, "):
        CompletionPredictor("magic")


@pytest.mark.parametrize(
    ("rgb", "sparse_depth", "text"),
    [
        (np.zeros((40, 50, 3)), np.zeros((40, 50), np.float32), "rgb must be uint8"),
        (np.zeros((40, 50, 3), np.uint8), np.zeros((40, 50)), "must be float32 metres"),
        (np.zeros((40, 50, 3), np.uint8), np.zeros((50, 40), np.float32), "the shape"),
        (np.zeros((31, 50, 3), np.uint8), np.zeros((31, 50), np.float32), "at least 32 x 32"),
    ],
)
def test_arrays_are_checked_as_by_the_engine(rgb, sparse_depth, text):
    with pytest.raises(InputError, match=text):
        CompletionPredictor("nearest").predict(rgb, sparse_depth)
