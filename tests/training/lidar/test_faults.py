"""Faults do what they say, and the fed depth stays as it was."""

import numpy as np
import pytest

from training.lidar.faults import DROPOUT_SHARE, add_fault
from training.lidar.simulate import random_share


def test_faults_do_what_they_say_and_leave_the_input_alone():
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
