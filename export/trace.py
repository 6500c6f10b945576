"""From a deploy graph to an ONNX model in memory."""

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator

import onnx
import torch
from onnx import numpy_helper

from export.deploy import DeployGraph
from export.errors import ExportError
from export.options import DEFAULT_OPSET

INPUTS = ("rgb", "sparse_depth")
# The free axes: N is always free, the others are in a dynamic graph.
AXES = ("batch", "height", "width")


def trace(
    graph: DeployGraph, *, size: tuple[int, int], dynamic: bool = False, opset: int = DEFAULT_OPSET
) -> onnx.ModelProto:
    """Trace a deploy graph into one ONNX model with its weights. Nothing is printed.

    The model has the lowest IR version that its operator set needs: 8 for operator set 18.

    Args:
        graph: the graph; its batch axis is free in the model.
        size: (height, width).
        dynamic: whether height and width are free, too.
        opset: ONNX operator set.

    Raises:
        ExportError: if the exporter fails or writes something that is not standard ONNX of that
            opset.
    """
    newest = onnx.defs.onnx_opset_version()
    if not DEFAULT_OPSET <= opset <= newest:
        raise ExportError(f"opset must be {DEFAULT_OPSET} to {newest}, got {opset}")
    free = dict.fromkeys(range(3 if dynamic else 1), torch.export.Dim.DYNAMIC)
    # Two frames are traced, because a batch of 1 would become a constant. Where they are free, the
    # sides are odd, because sides that fit the stride would leave no padding in the graph.
    height, width = (size[0] | 1, size[1] | 1) if dynamic else size
    try:
        example = torch.zeros(2, height, width, 3, dtype=torch.uint8), torch.zeros(2, height, width)
        with quiet(), torch.no_grad():
            program = torch.onnx.export(
                graph.eval(),
                example,
                dynamo=True,
                external_data=False,
                opset_version=opset,
                input_names=list(INPUTS),
                output_names=list(graph.heads),
                dynamic_shapes=(free, free),
                verbose=False,
            )
    except Exception as error:  # the exporter may raise any type
        raise ExportError(
            f"PyTorch's exporter failed on {graph.model.config.name!r} at {height} x {width}, "
            f"opset {opset}: {error}"
        ) from error
    assert program is not None
    model = program.model_proto
    # The exporter writes a newer version, which the older engines pinned in vehicles refuse.
    model.ir_version = onnx.helper.find_min_ir_version_for(list(model.opset_import))
    _strip_notes(model)
    _name_axes(model.graph)
    _drop_empty_padding(model.graph)
    drop_unused_weights(model.graph)
    check_standard(model, opset=opset)
    return model


def check_standard(model: onnx.ModelProto, *, opset: int) -> None:
    """Raise ExportError unless the model is valid and uses only the standard operators of an opset.

    Other operators, and functions, would belong to other domains, which `opset_import` names.
    """
    versions = {entry.domain: entry.version for entry in model.opset_import}
    if versions != {"": opset}:
        raise ExportError(f"opset {opset} was requested, the exporter wrote {versions}")
    try:
        onnx.checker.check_model(model, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError, ValueError) as error:
        raise ExportError(f"the exported graph is not valid ONNX: {error}") from error


def _nodes(graph: onnx.GraphProto) -> Iterator[onnx.NodeProto]:
    """Yield all nodes, including those of nested graphs."""
    for node in graph.node:
        yield node
        for attribute in node.attribute:
            for nested in (*([attribute.g] if attribute.HasField("g") else []), *attribute.graphs):
                yield from _nodes(nested)


def _strip_notes(model: onnx.ModelProto) -> None:
    """Remove the exporter's metadata, which contains local paths of source files."""
    graph = model.graph
    notes = (model, graph, *_nodes(graph), *graph.input, *graph.output, *graph.initializer)
    for holder in notes:
        holder.doc_string = ""
        del holder.metadata_props[:]
    # Inner shapes are expressions of the tracer's symbols; every reader infers them itself.
    del graph.value_info[:]


def _name_axes(graph: onnx.GraphProto) -> None:
    """Name the free axes; the tracer writes symbols and sums of symbols."""
    for tensors, places in ((graph.input, (0, 1, 2)), (graph.output, (0, -2, -1))):
        for tensor in tensors:
            dims = tensor.type.tensor_type.shape.dim
            for place, axis in zip(places, AXES, strict=True):
                if dims[place].dim_param:
                    dims[place].dim_param = axis


def _drop_empty_padding(graph: onnx.GraphProto) -> None:
    """Remove Pads of zero width, which copy the image; they occur if the size fits the stride."""
    constants = {weight.name: weight for weight in graph.initializer}
    for pad in [node for node in graph.node if node.op_type == "Pad"]:
        amounts = constants.get(pad.input[1])
        if amounts is None or numpy_helper.to_array(amounts).any():
            continue
        for node in graph.node:
            for index, name in enumerate(node.input):
                if name == pad.output[0]:
                    node.input[index] = pad.input[0]
        graph.node.remove(pad)


def drop_unused_weights(graph: onnx.GraphProto) -> None:
    """Remove initialisers that no node reads: ONNX Runtime warns about each at every load."""
    read = {name for node in _nodes(graph) for name in node.input}
    read |= {output.name for output in graph.output}
    for weight in [weight for weight in graph.initializer if weight.name not in read]:
        graph.initializer.remove(weight)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence the exporter's output, logs and warnings."""
    disabled = logging.root.manager.disable
    printed = io.StringIO()
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(printed),
    ):
        warnings.simplefilter("ignore")
        logging.disable(logging.CRITICAL)
        try:
            yield
        finally:
            logging.disable(disabled)
