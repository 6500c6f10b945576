"""The fast form of each operation against the plain one, forward and backward."""

import pytest
import torch
from torch.nn import functional as F

from models import blocks, fast_cpu, pooling
from models.fast_cpu import fast_on_cpu

#: Operation -> its arguments after the maps, and a shape that they fit.
CASES = {
    "cell_means": (pooling.cell_means, [(1,), (2,), (4,), (8,)]),
    "cell_maxima": (pooling.cell_maxima, [(1,), (2,), (4,), (8,)]),
    "means_around": (pooling.means_around, [(3,), (5,), (9,)]),
    "maxima_around": (pooling.maxima_around, [(3,), (5,), (7,), (9,), (15,)]),
    "enlarge": (blocks._enlarge, [(2,), (4,), (8,)]),
}
SHAPES = [(1, 1, 8, 16), (2, 2, 16, 24), (2, 8, 24, 8), (1, 9, 8, 8)]


def maps(shape, dtype=torch.float32, layout=torch.contiguous_format, seed=0):
    """Values of which no two are equal, so that each maximum has one place."""
    draw = torch.Generator().manual_seed(seed)
    count = torch.Size(shape).numel()
    values = torch.randperm(count, generator=draw).float() / count - 0.4
    return values.view(shape).to(dtype).contiguous(memory_format=layout)


def assert_equal_forward_and_backward(operation, x, *others, **tolerance):
    answers, gradients = [], []
    for form in (operation, operation.__wrapped__):
        inputs = [
            each.clone().requires_grad_() if isinstance(each, torch.Tensor) else each
            for each in (x, *others)
        ]
        answer = form(*inputs)
        weight = maps(answer.shape, answer.dtype, seed=1)
        (answer * weight).sum().backward()
        answers.append(answer)
        gradients.append([each.grad for each in inputs if isinstance(each, torch.Tensor)])
    assert answers[0].dtype == answers[1].dtype == x.dtype
    torch.testing.assert_close(*answers, **tolerance)
    for fast, plain in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, plain, **tolerance)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("operation", "arguments"),
    [
        pytest.param(operation, arguments, id=f"{name}{arguments}")
        for name, (operation, each) in CASES.items()
        for arguments in each
    ],
)
def test_fast_and_plain_are_equal(operation, arguments, shape, layout):
    assert operation.__wrapped__ is not operation
    assert_equal_forward_and_backward(operation, maps(shape, layout=layout), *arguments)


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_upsampling_in_bfloat16_is_as_exact_as_the_type(shape, factor):
    x = maps(shape, torch.bfloat16)
    assert_equal_forward_and_backward(blocks._enlarge, x, factor, rtol=2e-2, atol=4e-2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("shape", [(2, 4, 6, 5), (1, 16, 8, 12)])
def test_a_gate_is_a_product_in_either_layout(shape, layout, dtype):
    x = maps(shape, dtype, layout)
    boundary = maps((shape[0], 1, *shape[2:]), dtype, seed=2).abs()
    tolerance = {} if dtype is torch.float32 else {"rtol": 2e-2, "atol": 4e-2}
    assert_equal_forward_and_backward(blocks.gate, x, boundary, **tolerance)


def test_the_fast_form_is_that_of_a_cpu_outside_an_exported_graph():
    @fast_on_cpu(lambda x, number: x + number)
    def operation(x, number):
        return x - number

    class Module(torch.nn.Module):
        def forward(self, x):
            return operation(x, 2)

    x = torch.zeros(3)
    assert operation(x, 2).tolist() == [2, 2, 2]
    assert torch.export.export(Module(), (x,)).module()(x).tolist() == [-2, -2, -2]
    called = []
    count = fast_on_cpu(lambda x: called.append("fast") or x)(lambda x: called.append("plain") or x)
    count(torch.empty(1, device="meta"))
    assert called == ["plain"]


def test_the_gradient_of_few_maps_is_ours():
    x = maps((1, 2, 4, 4)).requires_grad_()
    assert "EnlargeFew" in type(fast_cpu.enlarge(x, 2).grad_fn).__name__
    assert "EnlargeFew" in type(blocks.upsample(x).grad_fn).__name__
    many = maps((1, 9, 4, 4)).requires_grad_()
    expected = F.interpolate(many, scale_factor=2.0, mode="bilinear", align_corners=False)
    assert type(blocks.upsample(many).grad_fn) is type(expected.grad_fn)
