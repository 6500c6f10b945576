"""Compares the answers of the bundled files in another engine with those of the installed one.

    python .ci/other_engines.py onnxruntime OTHER/bin/python [FILE.onnx ...]
    python .ci/other_engines.py openvino OTHER/bin/python [FILE.onnx ...]

OTHER is an environment with the engine and numpy, and without this project. OpenVINO only gets the
files in floating point, because it ends with a segmentation fault for 8-bit files.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

# Largest difference of float answers between two engines, for metres and for probabilities.
MOST_FLOAT = {"depth": 1e-3, "depth_uncertainty": 1e-3, "boundary": 1e-4}
# Largest mean difference of 8-bit files: rounding in another order changes some pixels by much. In
# the heads of metres it is a share of the mean.
MOST_INT8 = {"depth": 0.01, "depth_uncertainty": 0.05, "boundary": 0.01}
# Largest share of pixels that may have another class.
MOST_CLASSES = {"float": 1e-4, "int8": 0.01}

# Runs in the other environment with these arguments: engine, file of the inputs, model, file for
# the answers. It prints the version of the engine.
ANSWER = """
import sys
import numpy as np
engine, feed, model, to = sys.argv[1:]
feed = dict(np.load(feed))
if engine == "onnxruntime":
    import onnxruntime
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    heads = [tensor.name for tensor in session.get_outputs()]
    answers = dict(zip(heads, session.run(heads, feed)))
    version = onnxruntime.__version__
else:
    import openvino
    core = openvino.Core()
    single = {"INFERENCE_PRECISION_HINT": "f32"}
    outputs = core.compile_model(core.read_model(model), "CPU", single)(feed)
    answers = {tensor.get_any_name(): values for tensor, values in outputs.items()}
    version = openvino.__version__
np.savez(to, **answers)
print(engine, version)
"""


def main() -> None:
    """Compare each file; end with an error if an answer differs by more than its limit."""
    from runtime import Predictor
    from runtime.engine.bundled_models import find_model, list_bundled_models
    from runtime.recordings.bundled_stream import bundled_frames

    engine, python, *files = sys.argv[1:]
    frame = bundled_frames()[0]
    failed = []
    for file in files or map(find_model, list_bundled_models()):
        with Predictor(file, size="frame", warmup=0) as predictor:
            expected = predictor.predict(frame.rgb, frame.sparse_depth).heads
            is_int8 = predictor.contract.precision == "int8"
        if engine == "openvino" and is_int8:
            continue
        with tempfile.TemporaryDirectory() as folder:
            feed, to = Path(folder) / "feed.npz", Path(folder) / "answers.npz"
            np.savez(feed, rgb=frame.rgb[None], sparse_depth=frame.sparse_depth[None])
            command = [python, "-c", ANSWER, engine, feed, file, to]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                error = (done.stderr.strip() or f"ended by signal {-done.returncode}").splitlines()
                failed.append(f"{Path(file).name}: {error[-1]}")
                continue
            answers = {head: values[0] for head, values in np.load(to).items()}
        print(f"{Path(file).name} in {done.stdout.strip()}:")
        for head, values in expected.items():
            difference, limit = compare(head, answers[head], values, is_int8=is_int8)
            print(f"  {head:18}{difference:10.2g}, at most {limit:g}")
            if not difference <= limit:
                failed.append(f"{Path(file).name}: {head} differs by {difference:.2g}")
    sys.exit("\n".join(failed) or 0)


def compare(
    head: str, answer: np.ndarray, expected: np.ndarray, *, is_int8: bool
) -> tuple[float, float]:
    """Return how far an answer is from the expected one, and the limit."""
    if head == "semantic":
        differs = float((answer != expected).mean())
        return differs, MOST_CLASSES["int8" if is_int8 else "float"]
    difference = np.abs(answer.astype(np.float64) - expected)
    if not is_int8:
        return float(difference.max()), MOST_FLOAT[head]
    whole = 1.0 if head == "boundary" else float(expected.mean())
    return float(difference.mean() / whole), MOST_INT8[head]


if __name__ == "__main__":
    main()
