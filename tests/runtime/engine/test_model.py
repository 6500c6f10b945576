"""Graphs that promise the contract's outputs and give something else when they run."""

from collections.abc import Callable

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from runtime import InferenceError, Predictor

INT64 = onnx.TensorProto.INT64
HEADS = ("semantic", "depth", "boundary", "depth_uncertainty", "semantic_logits")


def behind(head: str, *nodes: onnx.NodeProto, **weights: object) -> Callable[..., None]:
    """An edit of a graph: more nodes behind an output, from "before" to its own name."""

    def edit(graph: onnx.GraphProto) -> None:
        for node in graph.node:
            for names in (node.input, node.output):
                for place, name in enumerate(names):
                    if name == head:
                        names[place] = "before"
        graph.node.extend(nodes)
        graph.initializer.extend(
            numpy_helper.from_array(np.asarray(values), name) for name, values in weights.items()
        )

    return edit


def repeated(head: str, *times: int) -> Callable[..., None]:
    """Repeat an output along its axes, by numbers that nobody knows before the graph runs."""
    return behind(
        head,
        helper.make_node("ReduceMin", ["colors"], ["darkest"], keepdims=0),
        helper.make_node("Mul", ["darkest", "nothing"], ["zero"]),
        helper.make_node("Cast", ["zero"], ["none"], to=INT64),
        helper.make_node("Add", ["times", "none"], ["repeats"]),
        helper.make_node("Tile", ["before", "repeats"], [head]),
        times=np.array(times),
        nothing=np.float32(0),
    )


@pytest.mark.parametrize(("head", "times"), [
    ("depth", (2, 1, 1)), ("semantic", (0, 1, 1)), ("boundary", (1, 1, 2)),
    ("semantic_logits", (1, 2, 1, 1)),
])  # fmt: skip
def test_an_answer_of_another_shape_is_an_inference_error(model_file, head, times):
    path = model_file(edit=repeated(head, *times), heads=HEADS)
    with pytest.raises(InferenceError, match=head):
        Predictor(path, warmup=0)


def test_an_answer_of_another_type_is_an_inference_error(model_file):
    def count_in_64_bits(graph):
        behind("semantic", helper.make_node("Cast", ["before"], ["semantic"], to=INT64))(graph)
        (output,) = (each for each in graph.output if each.name == "semantic")
        output.type.tensor_type.elem_type = INT64

    with pytest.raises(InferenceError, match="semantic as int64"):
        Predictor(model_file(edit=count_in_64_bits), warmup=0)


def test_an_answer_of_another_rank_is_one_of_another_shape(model_file):
    edit = behind("depth", helper.make_node("Squeeze", ["before", "axis"], ["depth"]), axis=[0])
    with pytest.raises(InferenceError, match="depth"):
        Predictor(model_file(edit=edit, heads=HEADS))
