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
# Head -> relative and absolute tolerance (metres, or probability), and the share of the pixels that
# may be beyond them; the same for 8 bits. They cover the rounding of other processors and ONNX
# Runtimes: 1.25 rounds values of 8 bits in other places than 1.31. A class changes the boundary
# around it.
LIMITS = {
    "semantic": ((0, 0, 0.001), (0, 0, 0.021)),
    "depth": ((0.005, 0.01, 0), (0.1, 0.05, 0.02)),
    "boundary": ((0, 0.01, 0.009), (0, 0.01, 0.1)),
    "depth_uncertainty": ((0.005, 0.01, 0), (0.1, 0.05, 0.1)),
}


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


@pytest.fixture(scope="module")
def answers(model) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return, for each head of a model, the answers now and the pinned ones."""
    now, folder = replay(model), REFERENCES / model
    pinned = {path.stem: cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in folder.iterdir()}
    assert now.keys() == pinned.keys(), f"pin {model} with python {__file__}"
    return now, pinned


@pytest.mark.parametrize("head", LIMITS)
def test_answers_are_those_pinned(model, answers, head):
    if head not in answers[0]:
        pytest.skip("the model does not say")
    relative, absolute, share = LIMITS[head][model.endswith("-int8")]
    now, pinned = (part[head].astype(np.float64) / SCALES.get(head, 1) for part in answers)
    assert now.shape == pinned.shape
    error = np.abs(now - pinned)
    assert (error > relative * pinned + absolute).mean() <= share, error.max()


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
