"""A traced graph whose trunk computes in half precision."""

from collections.abc import Iterable

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from export.trace import drop_unused_weights
from export.trunk import trunk


def to_half(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return the graph with the trunk in half precision; its inputs and outputs do not change.

    The weights are half the size. Metres and the choice between depths stay in single precision:
    half precision has steps of 6 cm at 100 m.
    """
    inside = set(trunk(model))
    half = onnx.ModelProto()
    half.CopyFrom(model)
    graph = half.graph
    weights = {weight.name: weight for weight in graph.initializer}
    made = {name for node in graph.node if node.name in inside for name in node.output}
    nodes: list[onnx.NodeProto] = []
    halved: set[str] = set()  # tensors and weights that have a copy in half precision
    restored: set[str] = set()  # tensors of the trunk that were cast back to single precision

    def to_half_name(name: str) -> str:
        copy = f"{name}_half"
        if name not in halved:
            halved.add(name)
            if name in weights:
                values = numpy_helper.to_array(weights[name]).astype(np.float16)
                graph.initializer.append(numpy_helper.from_array(values, copy))
            elif name not in made:
                nodes.append(_cast(name, copy, TensorProto.FLOAT16))
        return copy

    def restore(names: Iterable[str]) -> None:
        for name in sorted(made.intersection(names) - restored):
            restored.add(name)
            nodes.append(_cast(f"{name}_half", name, TensorProto.FLOAT))

    for node in graph.node:
        if node.name not in inside:
            restore(node.input)
            nodes.append(node)
            continue
        computed = onnx.NodeProto()
        computed.CopyFrom(node)
        # The other inputs of a Resize are its scales, which are single precision.
        for index in range(1 if node.op_type == "Resize" else len(node.input)):
            computed.input[index] = to_half_name(node.input[index])
        computed.output[0] = f"{node.output[0]}_half"
        nodes.append(computed)
    restore(output.name for output in graph.output)
    del graph.node[:]
    graph.node.extend(nodes)
    drop_unused_weights(graph)
    return half


def _cast(name: str, to_name: str, kind: int) -> onnx.NodeProto:
    return helper.make_node("Cast", [name], [to_name], name=f"cast_{to_name}", to=kind)
