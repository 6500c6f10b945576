"""Whether a picture shows the scene."""

import numpy as np
import pytest
import torch

from models import SSDNetLiteConfig, create_model
from models.picture import picture_shows
from training.loading.camera_faults import spoil


@pytest.fixture(scope="module")
def street():
    """Rectangles of many colours and sizes with a fine texture."""
    rng = np.random.default_rng(0)
    rgb = np.full((192, 320, 3), 120, np.uint8)
    for top, left, height, width in rng.integers(4, 120, (80, 4)):
        rgb[top : top + height, 2 * left : 2 * (left + width)] = rng.integers(20, 236, 3)
    return np.clip(rgb + rng.normal(0, 10, rgb.shape), 0, 255).astype(np.uint8)


def tensor(rgb):
    return torch.from_numpy(rgb.transpose(2, 0, 1).copy())[None].float()


@pytest.mark.parametrize(("fault", "strength", "least", "most"), [
    ("blurred", 0.0001, 1, 1), ("blurred", 0.3, 0, 0), ("dark", 0.1, 1, 1), ("dark", 0.8, 0, 0),
    ("noisy", 0.1, 1, 1), ("noisy", 1.0, 0, 0.5), ("white", 1.0, 0, 0), ("black", 1.0, 0, 0),
    ("grey", 1.0, 0, 0), ("overexposed", 1.0, 0, 0),
])  # fmt: skip
def test_spoilt_pictures_show_nothing(street, fault, strength, least, most):
    spoilt = spoil(street, fault, strength, np.random.default_rng(0))
    assert least <= float(picture_shows(tensor(spoilt))) <= most


def test_each_picture_of_a_batch_is_judged_alone(street):
    blank = np.full_like(street, 128)
    both = torch.cat([tensor(street), tensor(blank)])
    assert picture_shows(both).flatten().tolist() == [1, 0]


def test_a_network_that_judges_answers_a_bad_picture_with_the_returns(street):
    torch.manual_seed(0)
    network = create_model("ssdnet-nano", judges_picture=True).eval()
    returns = torch.zeros(1, 1, 192, 320)
    returns[..., ::4, ::2] = 30.0
    with torch.no_grad():
        depth = network(tensor(np.full_like(street, 128)), returns).depths[0]
    inner = depth[..., 24:-24, 24:-24] * network.config.max_depth_m
    assert torch.allclose(inner, torch.tensor(30.0), rtol=0.02)
    assert not SSDNetLiteConfig().judges_picture
