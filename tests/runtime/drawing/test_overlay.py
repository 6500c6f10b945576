"""The overlay shows what was predicted, at a handy size, and says what its colours mean."""

import dataclasses

import cv2
import numpy as np
import pytest

from runtime.drawing.overlay import Overlay


@pytest.fixture
def answered(answer):
    """(rgb, prediction) of a frame."""
    return answer(60, 80)


def change(prediction, *, frame_size=None, **heads):
    """The prediction with other answers; None takes a head away."""
    kept = {h: values for h, values in {**prediction.heads, **heads}.items() if values is not None}
    frame_size = frame_size or prediction.frame_size
    return dataclasses.replace(prediction, heads=kept, frame_size=frame_size)


def panels_of(strip, height):
    return [strip[i * height : (i + 1) * height] for i in range(5)]


def test_the_overlay_shows_what_was_predicted(contract, answered):
    _, prediction = answered
    height, width = 100, 300
    rgb = np.full((height, width, 3), (250, 10, 20), np.uint8)
    semantic = np.ones((height, width), np.uint8)
    semantic[:, :150] = 0
    depth = np.full((height, width), 2, np.float32)
    depth[:, 150:] = 80
    boundary = np.zeros((height, width), np.float32)
    boundary[:, 150:] = 1
    uncertainty = np.full((height, width), 1, np.float32)
    prediction = change(
        prediction,
        semantic=semantic,
        depth=depth,
        boundary=boundary,
        depth_uncertainty=uncertainty,
        frame_size=(height, width),
    )
    strip = Overlay(contract.classes, contract.max_depth_m).draw(rgb, prediction)
    image, classes, depths, uncertainties, boundaries = panels_of(strip, height)
    assert image[60, 60].tolist() == [20, 10, 250], "blue first"
    dark, red = np.array([128, 0, 0]), np.array([30, 30, 200])
    for column, color in ((60, dark), (240, red)):
        expected = 0.7 * color + 0.3 * np.array([20, 10, 250])
        assert abs(classes[60, column] - expected).max() <= 1
    near, far = depths[60, 60].astype(int), depths[60, 240].astype(int)
    assert near.sum() > 500, "near is bright"
    assert far.sum() < 20, "the far end is black"
    unsure, sure = uncertainties[60, 60].astype(int), uncertainties[60, 240].astype(int)
    assert unsure[1] > 200, "a metre at 2 m is bright"
    assert sure.sum() < 250, "a metre at 80 m is dark"
    assert boundaries[60, 60].tolist() == [0, 0, 0]
    assert boundaries[60, 240].tolist() == [255, 255, 255]
    assert strip.shape[0] > 5 * height, "the legend"


@pytest.mark.parametrize("step", [1, 3])
def test_returns_are_dots_on_the_image_in_the_colours_of_the_depth(contract, answered, step):
    _, prediction = answered
    height, width = 40 * step, 90 * step
    rgb = np.full((height, width, 3), 128, np.uint8)
    returns, depth = np.zeros((2, height, width), np.float32)
    depth[:] = 2
    # At step 3 both are of one pixel: the nearest is in front.
    returns[10 * step, 20 * step : 21 * step] = np.linspace(70, 2, step) if step > 1 else 2
    returns[-1, -1] = np.nan
    prediction = change(
        prediction,
        semantic=None,
        depth=depth,
        boundary=None,
        depth_uncertainty=None,
        frame_size=(height, width),
    )
    overlay = Overlay(contract.classes, contract.max_depth_m)
    panels = overlay.panels(rgb, prediction, returns, widest=90)
    changed = np.argwhere((panels["image with returns"] != 128).any(axis=-1)).tolist()
    assert changed == [[10, 20]]
    np.testing.assert_array_equal(panels["image with returns"][10, 20], panels["depth"][0, 0])
    assert "image" in overlay.panels(rgb, prediction, 0 * depth)


def test_the_legend_has_the_colours_of_the_classes(contract, answered):
    _, prediction = answered
    only_classes = change(prediction, depth=None, boundary=None, depth_uncertainty=None)
    strip = Overlay(contract.classes, contract.max_depth_m).draw(None, only_classes)
    legend = strip[prediction.frame_size[0] :]
    for info in contract.classes:
        blue_first = info.color[::-1]
        assert np.count_nonzero((legend == blue_first).all(axis=-1)) == 13 * 13, info.name


def test_the_depth_colours_are_the_same_for_every_frame(contract, answered):
    rgb, prediction = answered
    overlay = Overlay(contract.classes, contract.max_depth_m)

    def color_at_10_m(rest_m):
        depth = np.full(prediction.depth.shape, rest_m, np.float32)
        depth[40, 40] = 10
        drawn = overlay.draw(rgb, change(prediction, depth=depth))
        return drawn[40, 2 * 80 + 40].tolist()

    assert color_at_10_m(1) == color_at_10_m(70)


def test_the_sky_has_no_depth(contract, answered):
    rgb, prediction = answered
    grey = [110, 110, 110]
    ids = np.zeros((60, 80), np.uint8)
    ids[:30] = 1
    plain = Overlay(contract.classes, contract.max_depth_m)
    classes = (contract.classes[0], dataclasses.replace(contract.classes[1], name="Sky"))
    sky = Overlay(classes, contract.max_depth_m)
    with_sky = sky.panels(rgb, change(prediction, semantic=ids))
    without = plain.panels(rgb, change(prediction, semantic=ids))
    assert [*with_sky][2:4] == ["depth, none in the sky", "uncertainty, % of the depth"]
    for hidden, shown in zip([*with_sky.values()][2:4], [*without.values()][2:4], strict=True):
        assert (hidden[:30] == grey).all()
        assert np.array_equal(hidden[30:], shown[30:])
        assert not (shown == grey).all(axis=-1).any()
    unknown = sky.panels(rgb, change(prediction, semantic=None))["depth"]
    assert not (unknown == grey).all(axis=-1).any(), "nothing is known to be sky"


def test_a_depth_that_is_none_is_not_drawn_as_near(contract, answered):
    rgb, prediction = answered
    depth = np.full((60, 80), 20, np.float32)
    depth[40:, :40], depth[40:, 40:] = 0, -1
    overlay = Overlay(contract.classes, contract.max_depth_m)
    drawn = overlay.draw(rgb, change(prediction, depth=depth))
    for panel in (drawn[:60, 2 * 80 : 3 * 80], drawn[:60, 3 * 80 : 4 * 80]):
        assert (panel[40:] == 110).all()
        assert not (panel[20:40] == 110).all(axis=-1).any()


@pytest.mark.parametrize(
    "size",
    [(375, 1242), (33, 35), (1080, 1920), (32, 20600), (65600, 32)],
)
def test_the_overlay_of_any_size_is_of_a_handy_size(contract, answered, size):
    _, prediction = answered
    resized = {
        name: cv2.resize(getattr(prediction, name), size[::-1])
        for name in ("semantic", "depth", "boundary", "depth_uncertainty")
    }
    prediction = change(prediction, frame_size=size, **resized)
    overlay = Overlay(contract.classes, contract.max_depth_m)
    strip = overlay.draw(np.zeros((*size, 3), np.uint8), prediction)
    assert strip.dtype == np.uint8
    assert strip.shape[1] <= (960 if size[1] >= 2 * size[0] else 5 * 640)
    assert strip.shape[0] <= 5 * 4096 + 200


def test_the_overlay_leaves_out_missing_heads(contract, answered):
    rgb, prediction = answered
    no_uncertainty = change(prediction, depth_uncertainty=None)
    only_depth = change(no_uncertainty, semantic=None, boundary=None)
    overlay = Overlay(contract.classes, contract.max_depth_m)
    assert overlay.draw(rgb, only_depth).shape[1] == 2 * 80
    assert overlay.draw(rgb, no_uncertainty).shape[1] == 4 * 80
    assert overlay.draw(rgb, prediction).shape[1] == 5 * 80
    only_boundary = change(no_uncertainty, semantic=None, depth=None)
    assert Overlay((), contract.max_depth_m).draw(rgb, only_boundary).shape == (60, 2 * 80, 3)
