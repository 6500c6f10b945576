"""A few frames of a run, however long it is, are kept as pictures."""

import dataclasses

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.drawing.report_page.samples import SampleKeeper
from runtime.prediction import Latency


@pytest.fixture
def look(contract, model_file, make_frame):
    """Let a keeper see n frames, the time of frame i by `time_ms`, its marks by `marks`."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    prediction = Predictor(model_file(heads=heads)).predict(rgb, depth)

    def run(n, time_ms=lambda i: 1.0, marks=lambda i: ()):
        keeper = SampleKeeper(contract)
        for index in range(n):
            latency = Latency(0, 0, 0, time_ms(index))
            timed = dataclasses.replace(prediction, latency=latency)
            keeper.add(f"f{index}", rgb, timed, marks(index))
        return keeper.samples()

    return run


@pytest.mark.parametrize("n", [1, 2, 6, 7, 20, 500])
def test_they_are_evenly_spread(look, n):
    samples = look(n)
    places = [sample.index for sample in samples]
    assert places == sorted(places)
    assert len(set(np.diff(places))) <= 1
    assert places[0] == 0
    assert min(n, 3) <= len(places) <= 6
    assert n - places[-1] <= max(n // 3, 1) + 1, "the end is seen, too"


def test_the_slowest_and_the_first_of_each_fault_are_kept(look):
    samples = look(
        200,
        time_ms=lambda i: 50.0 if i == 101 else 1.0,
        marks=lambda i: ("image_frozen",) if i in (37, 38, 39) else (),
    )
    kept = {sample.name: sample for sample in samples}
    assert kept["f101"].slowest
    assert kept["f37"].marks == ("image_frozen",)
    assert not {"f38", "f39"} & kept.keys()
    assert sum(sample.slowest for sample in samples) == 1


def test_they_are_pictures_of_the_frame(look, make_frame):
    rgb, _ = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2
    (sample,) = look(1)
    assert [title for title, _ in sample.panels] == ["image", "classes", "depth"]
    image = cv2.imdecode(np.frombuffer(sample.panels[0][1], np.uint8), cv2.IMREAD_COLOR_RGB)
    assert abs(image.astype(int) - rgb).mean() < 50, "noise is hard to encode"
    assert not sample.slowest, "of one"
