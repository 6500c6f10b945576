"""The benchmark of motion on a road of planes."""

import numpy as np

from motion import sweep_errors


def test_deskewing_is_exact_to_a_millimetre_and_needed():
    errors = sweep_errors(speed=15, turn=0.5)
    assert np.percentile(errors["each by its own time"][:, 1], 95) < 1e-3
    assert np.percentile(errors["as they are"][:, 1], 50) > 0.05
