"""What an evaluation feeds and scores for every LiDAR it is asked for, and its faults."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.errors import InputError
from training.datasets.sample import Sample
from training.evaluation.lidar_input import DROPOUT_SHARE, LidarInput, add_fault

SIZE = (48, 160)
K = np.array([[80.0, 0, 80], [0, 80.0, 20], [0, 0, 1]])


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def dense():
    depth = np.full(SIZE, 20.0, np.float32)
    depth[:5] = 0
    return Sample(
        rgb=np.zeros((*SIZE, 3), np.uint8),
        depth=depth,
        semantic=np.zeros(SIZE, np.uint8),
        intrinsics=K,
        name="dense",
    )


@pytest.fixture
def scanned(dense):
    """A recorded scan: row r is line r, nothing hidden."""
    lines = np.repeat(np.arange(SIZE[0], dtype=np.int16)[:, None], SIZE[1], axis=1)
    depth = np.full(SIZE, 20.0, np.float32)
    return replace(dense, depth=depth, scan_line=lines)


@pytest.mark.parametrize("text", ["own", "none", "64", "32", "16", "4", "1", "random:0.05"])
def test_texts_are_read_and_said_again(text):
    assert str(LidarInput.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["", "63", "0", "-4", "128", "random", "random:0", "random:2", "x"]
)
def test_other_texts_say_what_is_expected(text):
    with pytest.raises(InputError, match="divides 64"):
        LidarInput.parse(text)


def test_dense_depth_is_scored_as_a_whole_whatever_is_fed(dense, rng):
    returns = {}
    for text in ("none", "4", "16", "64", "own", "random:0.05"):
        frame = LidarInput.parse(text).split(dense, rng)
        assert frame.target is dense.depth
        assert not frame.fed[:5].any()  # nothing measures the sky
        returns[text] = np.count_nonzero(frame.fed)
    assert returns["none"] == 0
    assert returns["none"] < returns["4"] < returns["16"] < returns["64"]
    assert returns["random:0.05"] == pytest.approx(0.05 * 43 * 160, rel=0.25)


def test_a_recorded_scan_keeps_its_odd_lines_for_scoring(scanned, rng):
    even = np.arange(SIZE[0]) % 2 == 0
    for text, step in (("own", 2), ("32", 2), ("16", 4), ("8", 8)):
        frame = LidarInput.parse(text).split(scanned, rng)
        rows = np.arange(SIZE[0]) % step == 0
        assert (frame.fed[rows] == 20).all(), text
        assert not frame.fed[~rows].any(), text
        assert (frame.target[~even] == 20).all()
        assert not frame.target[even].any()
    thinned = LidarInput.parse("random:0.5").split(scanned, rng)
    assert not thinned.fed[~even].any()
    assert np.count_nonzero(thinned.fed) == pytest.approx(0.5 * 24 * 160, rel=0.1)
    assert LidarInput.parse("64").split(scanned, rng) is None


def test_a_recorded_input_is_fed_as_it_is_or_thinned(dense, rng):
    recorded = np.where(np.indices(SIZE).sum(axis=0) % 3 == 0, np.float32(7), np.float32(0))
    sample = replace(dense, sparse_depth=recorded)
    own = LidarInput.parse("own").split(sample, rng)
    assert (own.fed == recorded).all()
    assert own.target is sample.depth
    thinned = LidarInput.parse("random:0.5").split(sample, rng)
    kept = thinned.fed > 0
    assert (recorded[kept] == 7).all()
    assert kept.sum() == pytest.approx(0.5 * (recorded > 0).sum(), rel=0.1)
    assert not LidarInput.parse("none").split(sample, rng).fed.any()
    assert LidarInput.parse("16").split(sample, rng) is None


def test_without_depth_nothing_is_fed_or_scored(dense, rng):
    blind = replace(dense, depth=np.zeros(SIZE, np.float32))
    frame = LidarInput.parse("64").split(blind, rng)
    assert not frame.fed.any()
    assert not frame.target.any()


def test_faults_do_what_they_say_and_leave_the_input_alone(dense, rng):
    fed = LidarInput.parse("random:0.5").split(dense, rng).fed
    before = fed.copy()
    spoiled = add_fault(fed, "nan", rng)
    wrong = (fed > 0) & ~(spoiled == fed)
    assert wrong.sum() == pytest.approx(0.3 * (fed > 0).sum(), rel=0.1)
    kinds = (np.isnan(spoiled), np.isposinf(spoiled), spoiled < 0)
    assert all(kind.sum() > 0.2 * wrong.sum() for kind in kinds)
    assert sum(kind.sum() for kind in kinds) == wrong.sum()

    shifted = add_fault(fed, "shift", rng)
    assert (shifted[1:, 2:] == fed[:-1, :-2]).all()
    assert not shifted[0].any()
    assert not shifted[:, :2].any()

    dropped = add_fault(fed, "dropout", rng)
    gone = (fed > 0) & (dropped == 0)
    columns = np.nonzero(gone.any(axis=0))[0]
    assert len(columns) == pytest.approx(DROPOUT_SHARE * 160, abs=1)
    assert columns[0] == 160 - 1 - columns[-1]
    assert (add_fault(fed, "none", rng) == before).all()
    assert (fed == before).all()
