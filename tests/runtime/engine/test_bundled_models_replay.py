"""The bundled models' answers on the bundled stream are pinned: a change of any is seen.

The references lie in `replay/MODEL/`: each head of every fourth frame, thinned, one frame below the
other.
After a change that is meant to change them (new weights or another bundled model, say) look at the
answers, then write anew those of all models, or of some:

    python tests/runtime/engine/test_bundled_models_replay.py [MODEL ...]
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Prediction, Predictor, list_bundled_models
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames

REFERENCES = Path(__file__).parent / "replay"
# Every so many rows and columns of a head.
STEPS = {"semantic": 4, "depth": 8, "boundary": 8, "depth_uncertainty": 8}
# Units of a head's PNG a metre and of a probability of 1.
SCALES = {"depth": 256, "boundary": 255, "depth_uncertainty": 256}
# Room for the rounding of other processors and ONNX Runtimes, and no more.
SAME_CLASS = 0.999
METRES_TOLERANCE = 0.005  # of the depth or its uncertainty, and a centimetre
BOUNDARY_TOLERANCE = 0.01
# ONNX Runtime 1.25 rounds values of 8 bits in other places than 1.31: so far, in so many pixels.
INT8_TOLERANCE = 0.1  # of a depth or its uncertainty, and 5 cm
SHARES = {"boundary": 9 * (1 - SAME_CLASS)}  # a class changes the boundary around it
INT8_SHARES = {"semantic": 0.02, "depth": 0.02, "boundary": 0.1, "depth_uncertainty": 0.1}


def replay(model: str) -> dict[str, np.ndarray]:
    """Head -> the answers for these frames, thinned, one below the other, as its PNG holds them."""
    with Predictor(model) as predictor:
        heads = predictor.heads
        predictions = []
        for frame in bundled_frames()[::4]:
            prediction = predictor.predict(
                frame.rgb, frame.sparse_depth, focal_length_px=BUNDLED_FOCAL_LENGTH_PX
            )
            predictions.append(prediction)
    assert all(item.valid and not item.degraded for item in predictions)
    return {head: np.vstack([thinned(item, head) for item in predictions]) for head in heads}


def thinned(prediction: Prediction, head: str) -> np.ndarray:
    """A head's pixels that are pinned, in the units of its PNG."""
    step = STEPS[head]
    values = getattr(prediction, head)[step // 2 :: step, step // 2 :: step]
    if head not in SCALES:
        return values
    kind = np.uint8 if head == "boundary" else np.uint16
    return np.rint(np.minimum(values * SCALES[head], np.iinfo(kind).max)).astype(kind)


@pytest.fixture(scope="module", params=list_bundled_models())
def model(request) -> str:
    return request.param


def free_share(model: str, head: str) -> float:
    """Share of the pixels that may differ from those pinned."""
    return INT8_SHARES[head] if model.endswith("-int8") else SHARES.get(head, 0.0)


@pytest.fixture(scope="module")
def answers(model) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return, for each head of a model, the answers now and the pinned ones."""
    now, folder = replay(model), REFERENCES / model
    pinned = {path.stem: cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in folder.iterdir()}
    assert now.keys() == pinned.keys(), f"pin {model} with python {__file__}"
    return now, pinned


def test_classes_are_those_pinned(model, answers):
    now, pinned = (part["semantic"] for part in answers)
    assert now.shape == pinned.shape
    assert (now == pinned).mean() >= SAME_CLASS - free_share(model, "semantic")


@pytest.mark.parametrize("head", ["depth", "depth_uncertainty"])
def test_metres_are_those_pinned(model, answers, head):
    if head not in answers[0]:
        pytest.skip("the model does not say")
    now, pinned = (part[head].astype(np.float64) / SCALES[head] for part in answers)
    error_m = np.abs(now - pinned)
    is_int8 = model.endswith("-int8")
    limit_m = INT8_TOLERANCE * pinned + 0.05 if is_int8 else METRES_TOLERANCE * pinned + 0.01
    assert (error_m > limit_m).mean() <= free_share(model, head), error_m.max()


def test_boundaries_are_those_pinned(model, answers):
    now, pinned = (part["boundary"].astype(np.float64) / SCALES["boundary"] for part in answers)
    error = np.abs(now - pinned)
    assert (error > BOUNDARY_TOLERANCE).mean() <= free_share(model, "boundary"), error.max()


if __name__ == "__main__":
    for model in sys.argv[1:] or list_bundled_models():
        folder = REFERENCES / model
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("*.png"):
            old.unlink()
        for head, values in replay(model).items():
            path = folder / f"{head}.png"
            if not cv2.imwrite(str(path), values, (cv2.IMWRITE_PNG_COMPRESSION, 9)):
                raise SystemExit(f"cannot write {path}")
