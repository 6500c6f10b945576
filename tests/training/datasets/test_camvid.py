"""CamVid on small files in its real layout, and on the recording if it is there."""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from layouts import open_set
from layouts.camvid import write_frame
from layouts.pictures import write
from runtime.errors import DatasetError

CamVid = partial(open_set, "camvid")


@pytest.fixture
def camvid(tmp_path):
    for name, value in (("b_2", 3), ("a_1", 11)):
        image = np.zeros((12, 16, 3), np.uint8)
        image[..., 0] = 200  # red
        label = np.full((12, 16), value, np.uint8)
        label[0] = 9
        write_frame(tmp_path, image, label, name)
    return tmp_path


def test_camvid_gives_rgb_and_ignores_unlabelled(camvid):
    first, second = (CamVid(camvid)[i] for i in range(2))
    assert first.name == "camvid/a_1"
    assert (first.rgb[0, 0] == (200, 0, 0)).all()
    assert (first.semantic[1:] == 255).all()
    assert (first.semantic[0] == 9).all()
    assert (second.semantic[1:] == 3).all()
    assert not first.depth.any()
    assert first.sparse_depth is None


def test_camvid_errors_name_the_file(camvid):
    with pytest.raises(DatasetError, match="test: no such folder"):
        CamVid(camvid, split="test")
    write(camvid / "trainannot" / "a_1.png", np.full((12, 16), 12, np.uint8))
    with pytest.raises(DatasetError, match=r"a_1.png: class id 12"):
        CamVid(camvid)[0]
    write(camvid / "trainannot" / "a_1.png", np.zeros((12, 15), np.uint8))
    with pytest.raises(DatasetError, match="12x15 differs"):
        CamVid(camvid)[0]
    path = camvid / "train" / "b_2.png"
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(DatasetError, match="truncated or damaged"):
        CamVid(camvid)[1]
    (camvid / "trainannot" / "a_1.png").unlink()
    with pytest.raises(DatasetError, match=r"a_1.png: missing"):
        CamVid(camvid)


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="names no folder of recordings")
def test_real_camvid_split_sizes():
    real_data = Path(os.environ["SSDNET_DATA"])
    assert len(CamVid(real_data / "camvid")) == 367
    validation = CamVid(real_data / "camvid", split="val")
    assert len(validation) == 101
    assert set(np.unique(validation[0].semantic)) <= {*range(11), 255}
