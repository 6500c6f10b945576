"""Inputs for any ONNX model: free axes are filled where their meaning is certain."""

from types import SimpleNamespace

import numpy as np
import pytest

from runtime import InputError
from runtime.engine.example_inputs import make_feeds, make_input


@pytest.mark.parametrize(("shape", "filled", "notes"), [
    (["N", 3, "H", "W"], (4, 3, 32, 48), ()),
    (["batch", None, None, 3], (4, 32, 48, 3), ()),
    (["batch_size", "in_channels", "img_height", "img_width"], (4, 3, 32, 48), ()),
    (["N", "W", "H", 3], (4, 48, 32, 3), ()),
    (["N", 3, "H", 96], (4, 3, 32, 96), ("its own size",)),
    ([1, "x", "y", 1], (1, 32, 48, 1), ("its own batch",)),
    (["H", "W", 3], (32, 48, 3), ("its own batch",)),
    (["N", 8], (4, 8), ("its own size",)),
    ([], (), ("its own size", "its own batch")),
    (["s0", 3, 32, "s1"], None, ("s1",)),
    (["N", "a", "b"], None, ("a",)),
    (["N", "C", "x", 96], None, ("x",)),
])  # fmt: skip
def test_free_axes_are_filled_where_they_are_certain(shape, filled, notes):
    inputs = [SimpleNamespace(name="x", type="tensor(float)", shape=shape)]
    if filled is None:
        with pytest.raises(InputError, match=f"'{notes[0]}'"):
            make_feeds(inputs, size=(32, 48), batch=4)
        return
    feeds, found = make_feeds(inputs, size=(32, 48), batch=4)
    assert (feeds["x"].shape, found) == (filled, notes)


def test_names_of_axes_mean_the_same_in_all_inputs():
    shapes = {"image": [1, "s62", "s73", 3], "lidar": [1, "s62", "s73"]}
    inputs = [SimpleNamespace(name=n, type="tensor(float)", shape=s) for n, s in shapes.items()]
    for order in (inputs, inputs[::-1]):
        feeds, _ = make_feeds(order, size=(32, 48), batch=1)
        assert (feeds["image"].shape, feeds["lidar"].shape) == ((1, 32, 48, 3), (1, 32, 48))


@pytest.mark.parametrize(("element", "dtype", "values"), [
    ("uint8", "u1", 200), ("float16", "f2", 200), ("double", "f8", 200), ("int64", "i8", 1),
    ("bool", "?", 1),
])  # fmt: skip
def test_inputs_are_noise_or_one_valid_value(element, dtype, values):
    filled = make_input("x", f"tensor({element})", (50, 50))
    assert (filled.dtype, filled.shape) == (np.dtype(dtype), (50, 50))
    assert len(np.unique(filled)) >= values
    depth = make_input("sparse_depth", "tensor(float)", (1, 100, 100))
    assert 0.04 < (depth > 0).mean() < 0.06
    with pytest.raises(InputError, match="string"):
        make_input("x", "tensor(string)", (1,))
