"""CamVid on small files in its real layout, and on the recording if it is there."""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from layouts import open_set
from layouts.camvid import write_frame

CamVid = partial(open_set, "camvid")


def test_camvid_gives_rgb_and_ignores_unlabelled(tmp_path):
    for name, value in (("b_2", 3), ("a_1", 11)):
        label = np.full((12, 16), value, np.uint8)
        label[0] = 9
        write_frame(tmp_path, np.full((12, 16, 3), (200, 0, 0), np.uint8), label, name)
    first, second = (CamVid(tmp_path)[i] for i in range(2))
    assert first.name == "camvid/a_1"
    assert (first.rgb == (200, 0, 0)).all()
    assert (first.semantic[0] == 9).all()
    assert (first.semantic[1:] == 255).all()
    assert (second.semantic[1:] == 3).all()
    assert not first.depth.any()
    assert first.returns is None


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="names no folder of recordings")
def test_real_camvid_split_sizes():
    real_data = Path(os.environ["SSDNET_DATA"])
    assert len(CamVid(real_data / "camvid")) == 367
    validation = CamVid(real_data / "camvid", split="val")
    assert len(validation) == 101
    assert set(np.unique(validation[0].semantic)) <= {*range(11), 255}
