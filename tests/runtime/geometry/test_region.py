"""The part of a sensor that images show, by the fields of a CameraInfo alone."""

import numpy as np
import pytest

from runtime import Calibration
from runtime.geometry.assumptions import AssumptionWarning

SENSOR = np.array([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
CROPPED = np.array([[500.0, 0, 219.5], [0, 500, 179.5], [0, 0, 1]])
ROI = {"x_offset": 100, "y_offset": 60, "height": 360, "width": 440}


def read(k, size, **fields):
    info = {"k": k, "height": size[0], "width": size[1], **fields}
    found = Calibration.from_camera_info(info, np.eye(4), rectified=True)
    return found.intrinsics[:2, 2].tolist(), found.size


def test_a_region_of_the_stated_sensor_moves_the_principal_point():
    assert read(SENSOR, (480, 640), roi=ROI) == ([219.5, 179.5], (360, 440))


@pytest.mark.parametrize(("k", "of"), [(SENSOR, "whole sensor"), (CROPPED, "region of interest")])
def test_a_region_that_the_stated_size_cannot_hold_is_that_size(k, of):
    with pytest.warns(AssumptionWarning, match=of):
        assert read(k, (360, 440), roi=ROI) == ([219.5, 179.5], (360, 440))
