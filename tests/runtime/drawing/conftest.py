"""What is drawn."""

import pytest

from runtime import Predictor


@pytest.fixture
def answer(model_file, make_frame):
    """Give (rgb, prediction) of a frame of so many rows and columns."""

    def make(height, width):
        rgb, depth = make_frame(height, width)
        rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
        heads = ("semantic", "depth", "boundary", "depth_uncertainty")
        with Predictor(model_file(heads=heads), threads=1) as predictor:
            return rgb, predictor.predict(rgb, depth)

    return make
