"""Which thinned scans of a recorded stream are flagged as too few returns."""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime.preprocess import covers_little
from runtime.resize import move_returns

DATA = os.environ.get("SSDNET_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")


@pytest.mark.parametrize("size", [(125, 414), (375, 1242), (2160, 3840)])
def test_a_thinned_lidar_is_few_returns_at_the_same_count_of_lines_for_every_camera(size):
    # The engine's tests also run where training cannot.
    kitti_stream = pytest.importorskip("training.datasets.kitti_stream")
    sample = kitti_stream.KittiStream(Path(DATA) / "kitti_stream", first=0, last=0)[0]
    flagged = {}
    for lines in (64, 32, 16, 8, 4, 2, 1):
        kept = sample.scan_line % (64 // lines) == 32 // lines
        depth = move_returns(np.where(kept, sample.depth, 0).astype(np.float32), size)
        flagged[lines] = covers_little(depth, returns=np.count_nonzero(depth))
    assert [lines for lines, few in flagged.items() if few] == [2, 1]
