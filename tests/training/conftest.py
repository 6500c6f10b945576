"""Small networks and data. Trainings run on one thread: two workers with two threads each wait."""

import numpy as np
import pytest
import torch

from layouts import camvid
from models import SSDNetLite, SSDNetLiteConfig
from models.registry import NETWORKS, Entry

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def tiny_config():
    return SSDNetLiteConfig(encoder_widths=(8,) * 16, decoder_channels=(8, 8, 8))


@pytest.fixture
def tiny_lite(monkeypatch, tiny_config):
    """Make ssdnet-lite a network of few channels; return its configuration."""
    monkeypatch.setitem(NETWORKS, "ssdnet-lite", Entry(SSDNetLite, tiny_config))
    return tiny_config


@pytest.fixture
def data(tmp_path):
    """CamVid's layout with frames whose upper half is sky (blue) and lower half road (gray)."""
    rng = np.random.default_rng(0)
    for split in ("train", "val"):
        for index in range(6):
            horizon = int(rng.integers(20, 40))
            image = np.full((64, 80, 3), 90, np.uint8)
            image[:horizon] = (60, 160, 230)
            image = (image + rng.integers(0, 20, image.shape)).astype(np.uint8)
            label = np.full((64, 80), 3, np.uint8)
            label[:horizon] = 0
            camvid.write_frame(tmp_path / "data/camvid", image, label, str(index), split)
    return tmp_path / "data"
