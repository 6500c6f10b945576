"""The frames of a bag, answered by the actors of a cluster."""

import numpy as np

from runtime.predictor import Predictor
from runtime.sources.registry import choose_source, open_source

N, SIZE, START_NS, PERIOD_NS = 20, (48, 64), 1_700_000_000_000_000_000, 100_000_000
INTRINSICS = [[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]


def test_rows_are_the_answers_to_the_bag(predict_source, make_bag, make_frame):
    bag = make_bag("mcap")
    bag.info("/cam/camera_info", INTRINSICS, SIZE)
    for index in range(N):
        rgb, depth = make_frame(*SIZE, seed=index)
        bag.image("/cam/image_rect", rgb, "rgb8", START_NS + index * PERIOD_NS)
        if index != 4:
            bag.image("/depth/image_rect", depth, "32FC1", START_NS + index * PERIOD_NS)
    path = bag.write()
    rows = predict_source(choose_source("bag", path, reuse_depth_ms=0), actors=2).iter_rows()
    rows = sorted(rows, key=lambda row: row["index"])
    assert [row["index"] for row in rows] == list(range(N))
    with open_source("bag", path, reuse_depth_ms=0) as source:
        assert source.calibration.focal_length_px == 60
        with Predictor(threads=1, focal_length_px=60) as predictor:
            for row, listed in zip(rows, source.list_frames(), strict=True):
                frame = source.read(listed)
                expected = predictor.predict(frame.rgb, frame.sparse_depth)
                assert (row["reason"], row["name"]) == ("", listed.name)
                assert row["degraded"] == ("no_depth" if row["index"] == 4 else "")
                for head in predictor.heads:
                    np.testing.assert_array_equal(row[head], getattr(expected, head), strict=True)
