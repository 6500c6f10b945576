"""The example of bare ONNX Runtime gives the engine's answers, at every size and lens."""

import dataclasses
import runpy
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.bundled_models import find_model
from runtime.io.agreement import compare, file_limits, within
from runtime.sources.bundled_stream import bundled_frames, bundled_stream

EXAMPLE = Path(__file__).parents[2] / "examples" / "bare_onnxruntime.py"
HEADS = ("semantic", "depth", "boundary", "depth_uncertainty")
bare = runpy.run_path(str(EXAMPLE))


@pytest.mark.parametrize("focal_px", [None, 350.0, 1400.0])
@pytest.mark.parametrize(
    ("fixed", "frame_size"),
    [
        (None, (48, 64)),
        (None, (50, 64)),  # not a quarter more: its own size
        (None, (96, 129)),  # to 40 rows
        (None, (333, 401)),
        ((40, 56), (96, 129)),
        ((40, 200), (96, 129)),  # one side shrinks, one grows
        ((80, 120), (48, 64)),
    ],
)
def test_the_answers_are_the_engines_to_the_bit(
    model_file, make_frame, contract, fixed, frame_size, focal_px
):
    contract = dataclasses.replace(contract, trained_height=40, canonical_focal_px=700.0)
    path = model_file(size=fixed, heads=HEADS, contract=contract)
    rgb, depth = make_frame(*frame_size)
    depth[0, :5] = np.nan, np.inf, -1, 80, 200
    session, metadata = bare["open_model"](path)
    answers = bare["predict"](session, metadata, rgb, depth, focal_px)
    with Predictor(path, focal_length_px=focal_px) as predictor:
        prediction = predictor.predict(rgb, depth)
    assert answers.keys() == set(HEADS)
    for head, values in answers.items():
        np.testing.assert_array_equal(values, getattr(prediction, head), head)


def test_a_large_camera_with_the_bundled_model():
    """The prediction depends on the resize rule as well."""
    frame = bundled_frames()[0]
    rgb = cv2.resize(frame.rgb, (1664, 512), interpolation=cv2.INTER_CUBIC)[:, :700].copy()
    depth = np.zeros((512, 1664), np.float32)
    depth[::2, ::2] = frame.sparse_depth
    depth = depth[:, :700].copy()
    session, metadata = bare["open_model"](find_model(None))
    answers = bare["predict"](session, metadata, rgb, depth, 700.0)
    with Predictor(focal_length_px=700.0) as predictor:
        prediction = predictor.predict(rgb, depth)
        assert prediction.network_size[0] == predictor.contract.trained_height
        assert answers.keys() == set(predictor.heads)
    for head, values in answers.items():
        figures = compare(head, values, getattr(prediction, head))
        assert within(figures, file_limits(head, predictor.contract)), (head, figures)


def test_it_needs_nothing_of_this_project(tmp_path):
    """As a program, far from the packages."""
    rgb, depth = bundled_stream()
    program = (
        "import sys, runpy; sys.modules['runtime'] = None; sys.argv = sys.argv[1:];"
        "runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    arguments = [EXAMPLE, find_model(None), rgb / "00000.jpg", depth / "00000.png", "483"]
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    printed = dict(line.split(": ") for line in done.stdout.splitlines())
    assert printed["semantic"].startswith("uint8 (256, 832), 0 to ")
    assert printed["depth"].startswith("float32 (256, 832), ")
