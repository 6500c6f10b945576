"""Static quantisation of a traced graph to 8-bit integers (ONNX's QDQ form) by measured ranges."""

import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationMethod, QuantType
from onnxruntime.quantization.calibrate import TensorsData, create_calibrator
from onnxruntime.quantization.qdq_quantizer import QDQQuantizer

from export.trace import quiet
from export.trunk import trunk
from runtime.engine.session import open_session

# The arrays of the graph's inputs, by name, with a batch of one.
Feed = dict[str, NDArray[Any]]
# In 8 bits, the largest magnitude of a tensor over all frames may be this many times the median of
# its magnitudes in single frames: beyond it a few frames take the resolution of all others, of
# whose 256 steps fewer than 32 are left.
_MOST_UNEVEN = 8.0


@dataclass(frozen=True)
class Ranges:
    """What the tensors of a graph held on the frames of a calibration.

    Attributes:
        data: the least and the greatest value of each tensor.
        uneven: tensors whose magnitude on some frames is a multiple of that on most frames.
    """

    data: TensorsData
    uneven: frozenset[str]


def measure_ranges(model: onnx.ModelProto, feeds: Sequence[Feed]) -> Ranges:
    """Measure the tensors of the operators of the trunk, frame by frame."""
    frames: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        onnx.save(model, path)
        nodes = set(trunk(model))
        types = sorted({node.op_type for node in model.graph.node if node.name in nodes})
        calibrator = create_calibrator(
            path, types, augmented_model_path=str(Path(folder) / "augmented.onnx")
        )
        for feed in feeds:
            calibrator.collect_data(SimpleNamespace(get_next=partial(next, iter([feed]), None)))
            for name, tensor in calibrator.compute_data().items():
                low, high = (np.ravel(edge)[0] for edge in tensor.range_value)
                frames.setdefault(name, []).append((float(low), float(high)))
            calibrator.calibrate_tensors_range = None  # or the next frame's would be merged into it
    ranges = {name: np.array(found, np.float32) for name, found in frames.items()}
    data = {name: (found[:, 0].min(), found[:, 1].max()) for name, found in ranges.items()}
    largest = {name: np.abs(found).max(axis=1) for name, found in ranges.items()}
    uneven = {name for name, each in largest.items() if each.max() > _MOST_UNEVEN * np.median(each)}
    return Ranges(TensorsData(CalibrationMethod.MinMax, data), frozenset(uneven))


def quantize(
    model: onnx.ModelProto, ranges: Ranges, *, keep_float: Collection[str] = ()
) -> onnx.ModelProto:
    """Return the graph with the trunk in 8-bit integers.

    Activations are unsigned; weights are signed, with one scale for each channel, and within +-64.
    The sum of two products of 8-bit values then fits 16 bits, in which processors without VNNI
    (AVX2, AVX-512) compute it, and does not saturate.

    Args:
        model: a traced graph.
        ranges: ranges of its tensors, see `measure_ranges`.
        keep_float: names of nodes that are left in single precision, with what lies between them.
    """
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    nodes = trunk(model, without=keep_float)
    with quiet():  # hides the advice to optimise the graph first, since a traced graph is optimised
        quantizer = QDQQuantizer(
            copy,
            per_channel=True,
            reduce_range=True,
            weight_qType=QuantType.QInt8,
            activation_qType=QuantType.QUInt8,
            tensors_range=ranges.data,
            nodes_to_quantize=nodes,
            nodes_to_exclude=[],
            op_types_to_quantize=sorted({n.op_type for n in model.graph.node if n.name in nodes}),
            extra_options={},
        )
        quantizer.quantize_model()
    quantizer.model.topological_sort()  # ONNX demands it, ONNX Runtime does not
    quantized: onnx.ModelProto = quantizer.model.model
    return quantized


def strides(model: onnx.ModelProto, feed: Feed) -> dict[str, int]:
    """Return image size / grid size for each tensor that a convolution reads or writes.

    The graph runs once, on the frame, because a Resize may compute the size of its grid.
    """
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    names = sorted({name for node in convolutions for name in (node.input[0], node.output[0])})
    del copy.graph.output[:]
    for name in names:
        copy.graph.node.append(onnx.helper.make_node("Shape", [name], [f"{name}/shape"]))
        copy.graph.output.append(onnx.ValueInfoProto(name=f"{name}/shape"))
    session = open_session(copy.SerializeToString(), threads=2)
    width = feed["rgb"].shape[2]
    shapes = zip(names, session.run(None, feed), strict=True)
    return {name: round(width / int(shape[-1])) for name, shape in shapes}
