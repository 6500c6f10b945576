"""BaConv against Eq. 1 written as a plain loop, in PyTorch and exported."""

import numpy as np
import onnxruntime
import torch

from export.trace import quiet
from models.blocks import BaConv


def eq1(x, boundary, weight):
    """y(p) = sum over the window of w(p_n) x(p_n) (1 - B(p_n)), zero outside the map."""
    _, height, width = x.shape
    out = np.zeros((weight.shape[0], height, width))
    for v, u in np.ndindex(height, width):
        for i, j in np.ndindex(3, 3):
            y, z = v + i - 1, u + j - 1
            if 0 <= y < height and 0 <= z < width:
                out[:, v, u] += weight[:, :, i, j] @ x[:, y, z] * (1 - boundary[0, y, z])
    return out


def test_baconv_is_eq1_also_in_an_exported_graph():
    torch.manual_seed(0)
    layer = BaConv(3, 4).eval()
    x, boundary = torch.randn(1, 3, 6, 5), torch.rand(1, 1, 6, 5)
    expected = eq1(x[0].numpy(), boundary[0].numpy(), layer.conv.weight.detach().numpy())
    with quiet(), torch.no_grad():
        np.testing.assert_allclose(layer(x, boundary)[0], expected, atol=1e-5)
        assert torch.equal(layer(x, None), layer.conv(x))
        program = torch.onnx.export(layer, (x, boundary), dynamo=True, opset_version=18)
    nodes = program.model_proto.graph.node
    assert [(node.domain, node.op_type) for node in nodes] == [
        ("", "Sub"),
        ("", "Mul"),
        ("", "Conv"),
    ]
    content = program.model_proto.SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    names = [tensor.name for tensor in session.get_inputs()]
    (found,) = session.run(None, dict(zip(names, (x.numpy(), boundary.numpy()), strict=True)))
    np.testing.assert_allclose(found[0], expected, atol=1e-5)
