"""The example of bare ONNX Runtime gives the engine's answers, at every size and lens."""

import dataclasses
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from runtime import Predictor
from runtime.engine.bundled_models import find_model
from runtime.recordings.bundled_stream import bundled_stream

EXAMPLE = Path(__file__).parents[2] / "examples" / "bare_onnxruntime.py"
HEADS = ("semantic", "depth", "boundary", "depth_uncertainty")
bare = runpy.run_path(str(EXAMPLE))


@pytest.mark.parametrize(("fixed", "frame_size", "focal_px"), [
    (None, (50, 64), None),  # not a quarter more: its own size
    (None, (333, 401), 350.0),  # to 40 rows
    ((40, 200), (96, 129), 1400.0),  # one side shrinks, one grows
])  # fmt: skip
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
    if frame_size[0] > 40 * 1.25 and fixed is None:  # not moved to returns
        del answers["depth"], answers["depth_uncertainty"]
    for head, values in answers.items():
        np.testing.assert_array_equal(values, getattr(prediction, head), head)


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
