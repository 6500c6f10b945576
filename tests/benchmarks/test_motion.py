"""The benchmarks of motion on a road of planes and on a stream of a few seconds."""

import numpy as np

import soak_rates
from motion import sweep_errors
from runtime import Predictor


def test_deskewing_is_exact_to_a_millimetre_and_needed():
    errors = sweep_errors(speed=15, turn=0.5)
    assert np.percentile(errors["each by its own time"][:, 1], 95) < 1e-3
    assert np.percentile(errors["as they are"][:, 1], 50) > 0.05


def test_a_short_soak_of_three_rates_finds_nothing_wrong():
    with Predictor("ssdnet-nano", threads=1) as predictor:
        found, report = soak_rates.soak_rates(predictor, seconds=1, seed=0)
    assert found == []
    assert "depth_reused" in report
