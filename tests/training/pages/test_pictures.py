"""The picture of a batch shows what the network is trained on."""

from dataclasses import replace

import numpy as np
import torch

from layouts.batch import batch_of
from models import CLASS_TABLES
from runtime.drawing.overlay import Overlay
from training.pages.pictures import draw_batch
from training.scores.scoring import HeadMaps

HEIGHT, WIDTH = 64, 48
OVERLAY = Overlay(CLASS_TABLES["camvid"], 100.0)


def make_batch():
    """Two grey frames, road below, unknown above; the first has depth and two returns."""
    semantic = torch.full((2, HEIGHT, WIDTH), 255)
    semantic[:, 32:] = 3
    depth = torch.zeros(2, 1, HEIGHT, WIDTH)
    depth[0, :, 40:] = 10.0
    fed = torch.zeros(2, 1, HEIGHT, WIDTH)
    fed[0, 0, 40, 20], fed[0, 0, 40, 22] = 50.0, 5.0
    rgb = torch.full((2, 3, HEIGHT, WIDTH), 90, dtype=torch.uint8)
    rgb[:, 0] = 120
    names = ["a", "b"]
    return replace(batch_of(semantic, depth), rgb=rgb, sparse_depth=fed, names=names)


def color_at(metres):
    (panel,) = OVERLAY.panels(None, HeadMaps(depth=np.full((1, 1), metres, np.float32))).values()
    return panel[0, 0].tolist()


def test_labels_target_and_returns_stand_beside_the_image():
    picture = draw_batch(make_batch(), OVERLAY, count=2)
    assert picture.shape[1] == 4 * WIDTH
    image, classes, target, fed = (
        picture[: 2 * HEIGHT, WIDTH * index : WIDTH * (index + 1)] for index in range(4)
    )
    assert image[40, 20].tolist() == [90, 90, 120]
    road = CLASS_TABLES["camvid"][3].color[::-1]
    expected = 0.7 * np.array(road) + 0.3 * np.array([90, 90, 120])
    np.testing.assert_allclose(classes[40, 20], expected, atol=1)
    assert classes[HEIGHT + 30, 20].max() < 40  # unknown
    assert target[45, 20].tolist() == color_at(10.0)
    assert (target[HEIGHT + 45, 20] == target[30, 20]).all()  # none
    # Dots of 3 x 3, the nearer in front; elsewhere the image can be recognised.
    assert fed[41, 19].tolist() == color_at(50.0)
    assert fed[39, 21].tolist() == fed[40, 23].tolist() == color_at(5.0)
    faded = [115, 115, 125]
    assert fed[40, 18].tolist() == fed[42, 20].tolist() == fed[HEIGHT + 40, 20].tolist() == faded
    # The names, at the lower left of each frame.
    for bottom in (HEIGHT, 2 * HEIGHT):
        assert image[bottom - 16 : bottom, :16].max() > 200
    assert picture.shape[0] > 2 * HEIGHT  # the legend


def test_both_views_of_a_frame_are_drawn():
    """The first views of all frames come before their second ones; here those of one frame."""
    batch = make_batch()
    whole = draw_batch(batch, OVERLAY, count=2)
    views = draw_batch(replace(batch, names=["a"]), OVERLAY, count=1)
    assert views.shape == whole.shape
    text = slice(HEIGHT - 20, 2 * HEIGHT)  # where the names are
    assert (views[: text.start] == whole[: text.start]).all()
    assert (views[HEIGHT : text.stop - 20] == whole[HEIGHT : text.stop - 20]).all()
