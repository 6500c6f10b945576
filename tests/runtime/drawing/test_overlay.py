"""The overlay shows what was predicted, at a handy size, and says what its colours mean."""

import dataclasses

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.contract.heads import HEADS
from runtime.drawing.overlay import Overlay


@pytest.fixture
def answered(model_file, make_frame):
    """(rgb, prediction) of a frame of 60 x 80."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    with Predictor(model_file(heads=heads), threads=1) as predictor:
        return rgb, predictor.predict(rgb, depth)


@pytest.fixture
def overlay(contract):
    return Overlay(contract.classes, contract.max_depth_m)


def change(prediction, **heads):
    """The prediction with other answers; None takes a head away."""
    kept = {h: values for h, values in {**prediction.heads, **heads}.items() if values is not None}
    return dataclasses.replace(prediction, heads=kept)


def test_the_overlay_shows_what_was_predicted(overlay, answered):
    height, width = 100, 300
    rgb = np.full((height, width, 3), (250, 10, 20), np.uint8)
    right = np.arange(width) >= 150
    ones = np.ones((height, width), np.float32)
    prediction = change(
        answered[1],
        semantic=(ones * right).astype(np.uint8),
        depth=np.where(right, 80 * ones, 2 * ones),
        boundary=ones * right,
        depth_uncertainty=ones,
    )
    grid = overlay.draw(rgb, prediction)
    image, classes, depths, uncertainties, boundaries = (
        grid[i // 2 * height + 60, i % 2 * width :][:width].astype(int) for i in range(5)
    )
    assert image[60].tolist() == [20, 10, 250], "blue first"
    dark, red = np.array([128, 0, 0]), np.array([30, 30, 200])
    for column, color in ((60, dark), (240, red)):
        expected = 0.7 * color + 0.3 * np.array([20, 10, 250])
        assert abs(classes[column] - expected).max() <= 1
    assert depths[60].sum() > 500, "near is bright"
    assert depths[240].sum() < 20, "the far end is black"
    assert uncertainties[60, 1] > 200, "a metre at 2 m is bright"
    assert uncertainties[240].sum() < 250, "a metre at 80 m is dark"
    assert boundaries[[60, 240]].tolist() == [[0, 0, 0], [255, 255, 255]]
    assert grid[2 * height :, width:].any(), "the legend"


@pytest.mark.parametrize("step", [1, 3])
def test_returns_are_dots_on_the_image_in_the_colours_of_the_depth(overlay, answered, step):
    height, width = 40 * step, 90 * step
    rgb = np.full((height, width, 3), 128, np.uint8)
    returns, depth = np.zeros((2, height, width), np.float32)
    depth[:] = 2
    # At step 3 both are of one pixel: the nearest is in front.
    returns[10 * step, 20 * step : 21 * step] = np.linspace(70, 2, step) if step > 1 else 2
    returns[-1, -1] = np.nan
    only = change(answered[1], semantic=None, depth=depth, boundary=None, depth_uncertainty=None)
    panels = overlay.panels(rgb, only, returns, widest=90)
    changed = np.argwhere((panels["image with returns"] != 128).any(axis=-1)).tolist()
    assert changed == [[10, 20]]
    np.testing.assert_array_equal(panels["image with returns"][10, 20], panels["depth"][0, 0])
    assert "image" in overlay.panels(rgb, only, 0 * depth)


def test_the_depth_colours_are_the_same_for_every_frame(overlay, answered):
    rgb, prediction = answered

    def color_at_10_m(rest_m):
        depth = np.full(prediction.depth.shape, rest_m, np.float32)
        depth[40, 40] = 10
        return overlay.panels(rgb, change(prediction, depth=depth))["depth"][40, 40].tolist()

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


def test_a_depth_that_is_none_is_not_drawn_as_near(overlay, answered):
    rgb, prediction = answered
    depth = np.full((60, 80), 20, np.float32)
    depth[40:, :40], depth[40:, 40:] = 0, -1
    panels = overlay.panels(rgb, change(prediction, depth=depth))
    for name in ("depth", "uncertainty, % of the depth"):
        assert (panels[name][40:] == 110).all()
        assert not (panels[name][:40] == 110).all(axis=-1).any()


@pytest.mark.parametrize("size", [(33, 35), (32, 20600), (65600, 32)])
def test_a_jpeg_holds_the_overlay_of_any_size(overlay, answered, size):
    heads = {name: cv2.resize(values, size[::-1]) for name, values in answered[1].heads.items()}
    grid = overlay.draw(np.zeros((*size, 3), np.uint8), change(answered[1], **heads))
    assert grid.dtype == np.uint8
    assert max(grid.shape) < 65500


def test_the_overlay_leaves_out_missing_heads(contract, overlay, answered):
    rgb, prediction = answered
    only_depth = change(prediction, depth_uncertainty=None, semantic=None, boundary=None)
    assert overlay.draw(rgb, only_depth).shape[1] in (80 + 200, 2 * 80 + 200)
    only_boundary = change(prediction, depth_uncertainty=None, semantic=None, depth=None)
    assert Overlay((), contract.max_depth_m).draw(rgb, only_boundary).shape == (60, 2 * 80, 3)


def test_a_second_head_of_depth_has_a_panel_of_its_own(overlay, answered, monkeypatch):
    row = dataclasses.replace(HEADS["depth"], name="depth_2")
    monkeypatch.setitem(HEADS, "depth_2", row)
    rgb, prediction = answered
    far = np.full_like(prediction.depth, 60)
    panels = overlay.panels(rgb, change(prediction, semantic=None, depth_2=far))
    alone = overlay.panels(rgb, change(prediction, semantic=None, depth=far))
    np.testing.assert_array_equal(panels["depth_2"], alone["depth"])
    assert (panels["depth"] != panels["depth_2"]).any()


@pytest.mark.parametrize("size", [(1080, 1920), (375, 1242), (2160, 3840), (1600, 900)])
def test_the_overlay_fits_a_screen_and_its_panels_stay_large(contract, overlay, answered, size):
    heads = {name: cv2.resize(values, size[::-1]) for name, values in answered[1].heads.items()}
    prediction = change(answered[1], **heads)
    rgb = np.full((*size, 3), 90, np.uint8)
    grid = overlay.draw(rgb, prediction)
    assert grid.shape[0] <= 1080
    assert grid.shape[1] <= 1920
    image = (grid == 90).all(axis=-1)
    assert np.count_nonzero(image) > 0.05 * 1080 * 1920
    for info in contract.classes:
        swatch = (grid == info.color[::-1]).all(axis=-1)
        assert np.count_nonzero(swatch) >= 13 * 13, info.name


def test_the_legend_of_small_frames_stands_beside_it(contract, overlay, answered):
    rgb, prediction = answered
    grid = overlay.draw(rgb, prediction)
    panels = overlay.panels(rgb, prediction)
    np.testing.assert_array_equal(grid[30:60, :80], panels["image"][30:60])
    one = change(prediction, depth=None, boundary=None, depth_uncertainty=None)
    alone = overlay.draw(None, one)
    assert alone.shape[1] == 80 + 200
    for info in contract.classes:
        swatch = (alone[:, 80:] == info.color[::-1]).all(axis=-1)
        assert np.count_nonzero(swatch) == 13 * 13, info.name


def test_dots_of_returns_grow_with_the_picture_and_the_nearest_is_in_front(overlay, answered):
    rgb = np.full((360, 640, 3), 128, np.uint8)
    returns, depth = np.zeros((2, 360, 640), np.float32)
    returns[100, 100], returns[100, 101], depth[:] = 60, 2, 2
    only = change(answered[1], semantic=None, depth=depth, boundary=None, depth_uncertainty=None)
    panels = overlay.panels(rgb, only, returns)
    dots = panels["image with returns"]
    rows, columns = np.nonzero((dots != 128).any(axis=-1))
    assert {*zip(rows, columns, strict=True)} == {(y, x) for y in (99, 100) for x in (99, 100, 101)}
    near = (dots == panels["depth"][0, 0]).all(axis=-1)
    assert np.count_nonzero(near) == 4
