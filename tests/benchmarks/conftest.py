"""A model that is traced by hand: exporting one takes seconds."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper


@pytest.fixture
def small_model():
    return make_model


def make_model(rows=None, columns=None) -> bytes:
    """uint8 pixels -> 8 channels at half size -> 5 at full size, beside an unused depth."""
    rng = np.random.default_rng(0)
    shape = [1, rows or "height", columns or "width"]
    weights = {
        "w1": rng.normal(size=(8, 3, 3, 3)),
        "b1": rng.normal(size=8),
        "w2": rng.normal(size=(8, 5, 2, 2)),
    }
    nodes = [
        helper.make_node("Cast", ["rgb"], ["x"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["x"], ["y"], perm=[0, 3, 1, 2]),
        helper.make_node(
            "Conv", ["y", "w1", "b1"], ["z"], kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4
        ),
        helper.make_node(
            "ConvTranspose", ["z", "w2"], ["depth"], kernel_shape=[2, 2], strides=[2, 2]
        ),
    ]
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info("rgb", TensorProto.UINT8, [*shape, 3])],
        [helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, 5, None, None])],
        [numpy_helper.from_array(w.astype(np.float32), name) for name, w in weights.items()],
    )
    opset = [helper.make_opsetid("", 18)]
    return helper.make_model(graph, opset_imports=opset, ir_version=9).SerializeToString()
