"""Pictures of a faulty camera."""

import numpy as np
import pytest

from training.loading.camera_faults import CAMERA_FAULTS, spoil


@pytest.fixture
def picture():
    rgb = np.random.default_rng(0).integers(20, 236, (40, 60, 3), dtype=np.uint8)
    rgb[:, 30:] = 100
    return rgb


@pytest.mark.parametrize(("fault", "mean", "contrast"), [
    ("blurred", (85, 125), (0, 15)), ("dark", (0, 12), (0, 10)), ("noisy", (85, 125), (60, 100)),
    ("overexposed", (245, 255), (0, 30)), ("covered", (0, 125), (0, 80)), ("black", (0, 0), (0, 0)),
    ("grey", (128, 128), (0, 0)), ("white", (250, 250), (0, 0)),
])  # fmt: skip
def test_the_strongest_fault_leaves_what_it_says(picture, fault, mean, contrast):
    before = picture.copy()
    spoilt = spoil(picture, fault, 1.0, np.random.default_rng(0))
    assert (spoilt.dtype, spoilt.shape) == (np.uint8, picture.shape)
    assert mean[0] <= spoilt.mean() <= mean[1]
    assert contrast[0] <= spoilt.std() <= contrast[1]
    assert (picture == before).all()


@pytest.mark.parametrize("fault", CAMERA_FAULTS)
def test_a_weak_fault_changes_little(picture, fault):
    spoilt = spoil(picture, fault, 0.02, np.random.default_rng(0)).astype(int)
    assert 0 <= np.abs(spoilt - picture).mean() < 15
