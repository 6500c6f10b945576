"""What is fed and what is the target, for every LiDAR and every kind of depth."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.base.errors import InputError
from training.datasets.sample import Sample, make_frame
from training.lidar.split import LidarInput, OcclusionFilter, split_lidar

SIZE = (48, 160)
K = np.array([[80.0, 0, 80], [0, 80.0, 20], [0, 0, 1]])


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def dense():
    depth = np.full(SIZE, 20.0, np.float32)
    depth[:5] = 0
    frame = make_frame(np.zeros((*SIZE, 3), np.uint8), "dense", intrinsics=K)
    return Sample(frame, {"depth": depth, "semantic": np.zeros(SIZE, np.uint8)})


@pytest.fixture
def scanned(dense):
    """A recorded scan: row r is line r, nothing hidden."""
    lines = np.repeat(np.arange(SIZE[0], dtype=np.int16)[:, None], SIZE[1], axis=1)
    depth = np.full(SIZE, 20.0, np.float32)
    return replace(dense.with_returns(depth), targets={}, scan_line=lines)


@pytest.mark.parametrize("text", ["own", "none", "64", "32", "16", "4", "1", "random:0.05"])
def test_texts_are_parsed_and_formatted_again(text):
    assert str(LidarInput.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["", "63", "0", "-4", "128", "random", "random:0", "random:2", "x"]
)
def test_other_texts_are_refused(text):
    with pytest.raises(InputError, match=f"{text!r}.*64"):
        LidarInput.parse(text)


def split(sample, text, rng, **options):
    return split_lidar(sample, LidarInput.parse(text), rng, **options)


def test_dense_depth_is_scored_as_a_whole_whatever_is_fed(dense, rng):
    returns = {}
    for text in ("none", "4", "16", "64", "own", "random:0.05"):
        frame = split(dense, text, rng)
        assert frame.target is dense.depth
        assert not frame.fed[:5].any()  # nothing measures the sky
        returns[text] = np.count_nonzero(frame.fed)
    assert returns["none"] == 0
    assert returns["none"] < returns["4"] < returns["16"] < returns["64"]
    assert returns["random:0.05"] == pytest.approx(0.05 * 43 * 160, rel=0.25)


def test_a_recorded_scan_keeps_its_odd_lines_for_scoring(scanned, rng):
    even = np.arange(SIZE[0]) % 2 == 0
    for text, kept in (
        *(("own", slice(0, None, 2)), ("32", slice(0, None, 2)), ("16", slice(0, None, 4))),
        *(("8", slice(0, None, 8)), ("4", [8, 24, 40]), ("2", [8, 40]), ("1", [8])),
    ):
        frame = split(scanned, text, rng)
        rows = np.zeros(SIZE[0], bool)
        rows[kept] = True
        assert (frame.fed[rows] == 20).all(), text
        assert not frame.fed[~rows].any(), text
        assert (frame.target[~even] == 20).all()
        assert not frame.target[even].any()
    thinned = split(scanned, "random:0.5", rng)
    assert not thinned.fed[~even].any()
    assert np.count_nonzero(thinned.fed) == pytest.approx(0.5 * 24 * 160, rel=0.1)
    assert split(scanned, "64", rng) is None


def test_a_recorded_input_is_fed_as_it_is_or_thinned(dense, rng):
    recorded = np.where(np.indices(SIZE).sum(axis=0) % 3 == 0, np.float32(7), np.float32(0))
    sample = dense.with_returns(recorded)
    own = split(sample, "own", rng)
    assert (own.fed == recorded).all()
    assert own.target is sample.depth
    thinned = split(sample, "random:0.5", rng)
    kept = thinned.fed > 0
    assert (recorded[kept] == 7).all()
    assert kept.sum() == pytest.approx(0.5 * (recorded > 0).sum(), rel=0.1)
    assert not split(sample, "none", rng).fed.any()
    assert split(sample, "16", rng) is None


def test_lines_of_a_recorded_input_can_be_chosen_where_they_are_known(dense, scanned, rng):
    """The target beside it stays whole, all 64 lines too may be fed."""
    seen = scanned.depth + 1
    sample = replace(dense.with_returns(seen), scan_line=scanned.scan_line)
    for text, step in (("own", 1), ("64", 1), ("32", 2), ("16", 4)):
        frame = split(sample, text, rng)
        rows = np.arange(SIZE[0]) % step == 0
        assert (frame.fed[rows] == 21).all(), text
        assert not frame.fed[~rows].any(), text
        assert frame.target is sample.depth
    shifted = split(sample, "16", rng, first_line=1)
    assert np.nonzero(shifted.fed[:, 0])[0].tolist() == list(range(3, SIZE[0], 4))


@pytest.mark.parametrize("text", ["none", "own", "32", "16", "1", "random:0.3", "64"])
@pytest.mark.parametrize("first_line", [0, 1, 37])
def test_nothing_that_is_fed_of_a_recorded_scan_is_a_target(scanned, rng, text, first_line):
    """Something is left as target: all lines of a scan are never fed, not even in training."""
    for same_target in (True, False):
        frame = split(scanned, text, rng, same_target=same_target, first_line=first_line)
        if text == "64":
            assert frame is None
            continue
        assert not ((frame.fed > 0) & (frame.target > 0)).any()
        assert np.count_nonzero(frame.target) >= 0.5 * scanned.depth.size
        if not same_target:
            np.testing.assert_array_equal(frame.fed + frame.target, scanned.depth)


def test_returns_hidden_behind_nearer_ones_are_no_target(scanned, rng):
    depth = scanned.depth.copy()
    depth[20, 80] = 5.0
    frame = split(scanned.with_returns(depth), "own", rng)
    assert not frame.target[19, 76:85].any()
    assert not frame.target[27, 76:85].any()
    assert frame.target[29, 80] == frame.target[19, 85] == 20


def test_simulated_lines_need_intrinsics_and_a_random_share_none(dense, rng):
    blind = replace(dense, frame=replace(dense.frame, calibration=None))
    assert split(blind, "own", rng) is split(blind, "16", rng) is None
    assert split(blind, "random:0.1", rng).fed.any()


def test_slopes_stay_and_the_window_is_how_far_a_near_return_hides():
    returns = np.zeros((21, 21), dtype=np.float32)
    returns[10, 8], returns[10, 11] = 5.0, 40.0  # 40 m shows through beside 5 m
    returns[2, 2], returns[4, 2] = 10.0, 11.0  # a slope
    visible = OcclusionFilter(window=(15, 9)).apply(returns, returns)
    assert visible[10, 11] == 0
    assert (visible[10, 8], visible[2, 2], visible[4, 2]) == (5.0, 10.0, 11.0)
    assert OcclusionFilter(window=(15, 5)).apply(returns, returns)[10, 11] == 40.0
