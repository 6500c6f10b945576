"""The trunk of a traced graph: the nodes that may compute in less than single precision."""

from collections.abc import Collection, Sequence

import onnx

# A convolution with fewer input or output channels is outside the trunk, because it reads pixels,
# returns or boundary maps, or computes an answer. In single precision it takes little time.
_LEAST_CHANNELS = 16
_BETWEEN = ("Add", "Clip", "Mul", "Relu", "Resize")
_ACTIVATIONS = ("Clip", "Relu")


def trunk(model: onnx.ModelProto, *, without: Collection[str] = ()) -> list[str]:
    """Return the names of the nodes of the trunk, in the graph's order.

    These are its wide convolutions and the nodes between them: additions, products with a boundary
    map (BaConv), activations and upsamplings. The nodes that read the sensors or compute the
    answers do not belong to it, nor do the nodes named in `without` and the nodes between them.
    """
    graph = model.graph
    shapes = {weight.name: weight.dims for weight in graph.initializer}
    made: set[str] = set()  # tensors of the trunk
    nodes: list[onnx.NodeProto] = []
    for node in graph.node:
        if node.name in without:
            inside = False
        elif node.op_type == "Conv":
            shape = shapes.get(node.input[1], ())
            # A depthwise convolution has one channel per group.
            groups = next((item.i for item in node.attribute if item.name == "group"), 1)
            inside = len(shape) == 4 and min(groups * shape[1], shape[0]) >= _LEAST_CHANNELS
        else:
            inputs = [name for name in node.input if name and name not in shapes]
            inside = node.op_type in _BETWEEN and (any if node.op_type == "Mul" else all)(
                name in made for name in inputs
            )
        if inside:
            nodes.append(node)
            made.update(node.output)
    leading = _leading_to_a_convolution(nodes)
    return [node.name for node in nodes if node.name in leading]


def _leading_to_a_convolution(nodes: Sequence[onnx.NodeProto]) -> set[str]:
    """Names of the convolutions and of the nodes that lead to them through activations only."""
    read: set[str] = set()
    kept: set[str] = set()
    for node in reversed(nodes):
        is_activation = node.op_type in _ACTIVATIONS
        if node.op_type == "Conv" or is_activation or read.intersection(node.output):
            kept.add(node.name)
            if not is_activation or read.intersection(node.output):
                read.update(node.input)
    return kept
