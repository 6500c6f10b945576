"""What the example logs for Rerun, read back by Rerun's own reader."""

import runpy
import shutil
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from runtime import Predictor
from runtime.recordings.bundled_stream import (
    BUNDLED_FOCAL_LENGTH_PX,
    bundled_frames,
    bundled_stream,
)

rerun = pytest.importorskip("rerun", reason="the extra rerun is not installed")

EXAMPLE = Path(__file__).parents[2] / "examples/rerun_viewer.py"
FRAMES = 3


def read_log(path):
    """Entity -> component -> its values, in order."""
    logged = defaultdict(lambda: defaultdict(list))
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            for column in set(batch.schema.names) - {"log_time"}:
                logged[chunk.entity_path][column] += batch.column(column).to_pylist()
    return logged


def test_a_file_holds_what_is_predicted(monkeypatch, tmp_path):
    for folder in bundled_stream():
        (tmp_path / folder.name).mkdir()
        for path in sorted(folder.iterdir())[:FRAMES]:
            shutil.copy(path, tmp_path / folder.name)
    out = tmp_path / "a.rrd"
    folders = ["--rgb", tmp_path / "rgb", "--depth", tmp_path / "depth"]
    arguments = [*folders, "--focal-length", BUNDLED_FOCAL_LENGTH_PX, "--out", out]
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), *map(str, arguments)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    logged = read_log(out)
    frame = bundled_frames()[FRAMES - 1]
    with Predictor(focal_length_px=BUNDLED_FOCAL_LENGTH_PX) as predictor:
        expected = predictor.predict(frame.rgb, frame.sparse_depth)
    semantic = logged["/camera/classes"]["SegmentationImage:buffer"][-1][0]
    assert bytes(semantic) == expected.semantic.tobytes()
    depth = np.frombuffer(bytes(logged["/camera/depth"]["DepthImage:buffer"][-1][0]), np.float32)
    known = depth > 0  # not the sky
    np.testing.assert_array_equal(depth[known], expected.depth.ravel()[known])
    assert known.mean() > 0.5
    assert logged["/latency/total"]["frame"] == list(range(FRAMES))
    assert len(logged["/cloud"]["Points3D:positions"][-1]) > 1000
