"""Faults do what they say, and the fed depth stays as it was."""

import numpy as np
import pytest

from training.lidar.faults import (
    DROPOUT_SHARE,
    absorb,
    add_false_returns,
    add_fault,
    drop_sectors,
    misalign,
)
from training.lidar.simulate import random_share


def test_faults_are_as_documented_and_do_not_change_the_input():
    rng = np.random.default_rng(3)
    fed = random_share(np.full((48, 160), 20.0, np.float32), 0.5, rng)
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


K = np.array([[80.0, 0, 80], [0, 80.0, 24], [0, 0, 1]])


def test_a_misaligned_scan_moves_as_one_body(monkeypatch):
    """Returns of a wall: turned and shifted by one motion, none further than it allows."""
    fed = np.zeros((48, 160), np.float32)
    fed[8:40:8, 20:140:8] = 10.0
    monkeypatch.setattr("training.lidar.faults.MISALIGNMENT_DEG", 3.0)
    monkeypatch.setattr("training.lidar.faults.MISALIGNMENT_M", 0.2)
    moved = misalign(fed, K, np.random.default_rng(1))
    assert np.count_nonzero(moved) == np.count_nonzero(fed)
    there, here = np.argwhere(moved), np.argwhere(fed)
    steps = there[np.lexsort(there.T)] - here[np.lexsort(here.T)]
    assert (steps.mean(axis=0) != 0).any()
    # 3 degrees are 4.2 px, and up to 1.4 px more at the sides; 0.2 m at 10 m are 1.6 px.
    assert np.abs(steps).max() <= 8
    assert steps.std(axis=0).max() < 2
    assert 0 < np.abs(moved[moved > 0] - 10).max() < 0.2 + 10 * np.deg2rad(3) * 1.2


def test_sectors_are_lost_from_top_to_bottom():
    fed = np.full((48, 160), 20.0, np.float32)
    counts = set()
    for seed in range(30):
        left = drop_sectors(fed, np.random.default_rng(seed))
        lost = left == 0
        assert (lost == lost[0]).all()
        assert 8 <= lost[0].sum() <= 3 * 48
        counts.add(np.count_nonzero(np.diff(lost[0].astype(int), prepend=0) == 1))
    assert counts == {1, 2, 3}
    assert (fed == 20).all()


def test_a_thing_or_its_upper_part_returns_nothing():
    fed = np.full((60, 100), 20.0, np.float32)
    semantic = np.full((60, 100), 3, np.uint8)
    semantic[20:40, 30:60] = 8
    semantic[45:50, 10:20] = 8  # another thing of the class
    semantic[50:] = 255
    cars = [semantic == 8, np.zeros((60, 100), bool)]
    cars[0][45:] = False
    cars[1][45:50, 10:20] = True
    wholes, parts, none = 0, 0, 0
    for seed in range(200):
        lost = absorb(fed, semantic, np.random.default_rng(seed)) == 0
        if not lost.any():
            none += 1  # the road around is no thing
            continue
        (car,) = (car for car in cars if (lost & car).any())
        assert not lost[~car].any()
        rows = np.flatnonzero(car.any(axis=1))
        lost_rows = np.flatnonzero(lost.any(axis=1))
        assert lost_rows[0] == rows[0]  # from the top
        np.testing.assert_array_equal(
            lost[rows[0] : lost_rows[-1] + 1], car[rows[0] : lost_rows[-1] + 1]
        )
        wholes += len(lost_rows) == len(rows)
        parts += len(lost_rows) < len(rows)
    assert none > 100
    assert wholes > 5
    assert parts > 5
    assert (fed == 20).all()


def test_false_returns_are_near_or_behind_and_few():
    rng = np.random.default_rng(1)
    fed = np.where(rng.random((200, 500)) < 0.04, np.float32(20.0), np.float32(0))
    before = fed.copy()
    damaged = add_false_returns(fed, rng)
    assert np.array_equal(fed, before)
    changed = damaged[damaged != fed]
    assert 2 <= changed.size <= 60
    near, behind = changed[changed < 20], changed[changed >= 20]
    assert 1.5 <= near.min() <= near.max() <= 10
    assert 25.99 <= behind.min() <= behind.max() <= 80.01
