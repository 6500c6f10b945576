"""BaConv as it is exported against Eq. 1 written as a plain loop."""

import numpy as np
import onnx
import onnxruntime
import torch

from export.trace import quiet
from models.blocks import BaConv


def eq1_loop(x, boundary, weight):
    """y(p) = sum over the window of w(p_n) x(p_n) (1 - B(p_n)); nothing outside the picture."""
    channels, height, width = x.shape
    outputs, _, kernel, _ = weight.shape
    y = np.zeros((outputs, height, width))
    for out in range(outputs):
        for row in range(height):
            for column in range(width):
                for i in range(kernel):
                    for j in range(kernel):
                        r, c = row + i - kernel // 2, column + j - kernel // 2
                        if 0 <= r < height and 0 <= c < width:
                            for channel in range(channels):
                                y[out, row, column] += (
                                    weight[out, channel, i, j]
                                    * x[channel, r, c]
                                    * (1 - boundary[r, c])
                                )
    return y


def test_lowered_baconv_is_eq1(tmp_path):
    torch.manual_seed(0)
    layer = BaConv(3, 4).eval()
    x, boundary = torch.randn(1, 3, 7, 9), torch.rand(1, 1, 7, 9)
    path = tmp_path / "baconv.onnx"
    with quiet(), torch.no_grad():
        torch.onnx.export(
            layer, (x, boundary), path, dynamo=True, external_data=False, opset_version=18
        )

    nodes = onnx.load(path).graph.node
    assert [node.op_type for node in nodes] == ["Sub", "Mul", "Conv"]
    assert {node.domain for node in nodes} == {""}

    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [tensor.name for tensor in session.get_inputs()]
    (y,) = session.run(None, dict(zip(names, (x.numpy(), boundary.numpy()), strict=True)))
    expected = eq1_loop(x[0].numpy(), boundary[0, 0].numpy(), layer.conv.weight.detach().numpy())
    np.testing.assert_allclose(y[0], expected, rtol=1e-4, atol=1e-5)
