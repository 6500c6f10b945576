"""The bundled model's answers on the bundled stream are pinned: a change of any is seen.

The references lie in `replay/`: each head of all frames, thinned and one below the other. After a
change that is meant to change them (a new bundled model, say) look at the answers, then write anew:

    python tests/runtime/test_bundled_replay.py
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Predictor
from runtime.stream.bundled import bundled_stream
from runtime.stream.frames import list_frames, read_frame

REFERENCES = Path(__file__).parent / "replay"
#: Every so many rows and columns; units of the PNG a metre and of a probability of 1.
SEMANTIC_STEP, MAP_STEP = 4, 8
DEPTH_SCALE, BOUNDARY_SCALE = 256, 255
# Room for the rounding of other processors and ONNX Runtimes, and no more.
SAME_CLASS = 0.999
DEPTH_TOLERANCE = 0.005  # of the depth, and a centimetre
BOUNDARY_TOLERANCE = 0.01


def replay() -> dict[str, np.ndarray]:
    """Head -> the answers for all frames, thinned, one below the other, as its PNG holds them."""
    with Predictor() as predictor:
        predictions = []
        for files in list_frames(*bundled_stream()):
            frame = read_frame(files, depth_scale=256.0)
            predictions.append(predictor.predict(frame.rgb, frame.sparse_depth))
    assert all(item.valid and not item.degraded for item in predictions)
    thin = np.s_[MAP_STEP // 2 :: MAP_STEP, MAP_STEP // 2 :: MAP_STEP]
    semantic = np.vstack([p.semantic[::SEMANTIC_STEP, ::SEMANTIC_STEP] for p in predictions])
    depth = np.vstack([p.depth[thin] for p in predictions])
    boundary = np.vstack([p.boundary[thin] for p in predictions])
    return {
        "semantic": semantic,
        "depth": np.rint(depth * DEPTH_SCALE).astype(np.uint16),
        "boundary": np.rint(boundary * BOUNDARY_SCALE).astype(np.uint8),
    }


@pytest.fixture(scope="module")
def answers() -> dict[str, np.ndarray]:
    return replay()


def reference(head: str) -> np.ndarray:
    return cv2.imread(str(REFERENCES / f"{head}.png"), cv2.IMREAD_UNCHANGED)


def test_classes_are_those_pinned(answers):
    pinned = reference("semantic")
    assert answers["semantic"].shape == pinned.shape
    assert (answers["semantic"] == pinned).mean() >= SAME_CLASS


def test_depth_is_that_pinned(answers):
    pinned = reference("depth").astype(np.float64) / DEPTH_SCALE
    error_m = np.abs(answers["depth"] / DEPTH_SCALE - pinned)
    assert (error_m <= DEPTH_TOLERANCE * pinned + 0.01).all(), error_m.max()


def test_boundaries_are_those_pinned(answers):
    pinned = reference("boundary").astype(np.float64) / BOUNDARY_SCALE
    error = np.abs(answers["boundary"] / BOUNDARY_SCALE - pinned)
    assert (error <= BOUNDARY_TOLERANCE).all(), error.max()


if __name__ == "__main__":
    REFERENCES.mkdir(exist_ok=True)
    for name, values in replay().items():
        path = REFERENCES / f"{name}.png"
        if not cv2.imwrite(str(path), values, (cv2.IMWRITE_PNG_COMPRESSION, 9)):
            raise SystemExit(f"cannot write {path}")
