"""Poolings, upsampling and gate, in their fast and their plain form, against PyTorch's own."""

import pytest
import torch
from torch.nn import functional as F

from models import blocks, pooling
from models.fast_cpu import fast_on_cpu


def interpolate(x, factor):
    return F.interpolate(x, scale_factor=float(factor), mode="bilinear", align_corners=False)


# Operation, the same in PyTorch, and sides, windows or factors.
CASES = [
    (pooling.cell_means, F.avg_pool2d, (1, 2, 4, 8)),
    (pooling.cell_maxima, F.max_pool2d, (1, 2, 4, 8)),
    (pooling.window_means, lambda x, window: F.avg_pool2d(x, window, 1, window // 2), (3, 5, 9)),
    (
        pooling.window_maxima,
        lambda x, window: F.max_pool2d(x, window, 1, window // 2),
        (3, 5, 7, 9, 15),
    ),
    (blocks.enlarge, interpolate, (2, 4, 8)),
]
SHAPES = [(1, 1, 8, 16), (2, 2, 16, 24), (2, 8, 24, 8), (1, 9, 8, 8)]
ROUNDED = {"rtol": 2e-2, "atol": 4e-2}


def maps(shape, dtype=torch.float32, layout=torch.contiguous_format, seed=0):
    """Values of which no two are equal, so that each maximum has one place."""
    draw = torch.Generator().manual_seed(seed)
    count = torch.Size(shape).numel()
    values = torch.randperm(count, generator=draw).float() / count - 0.4
    return values.view(shape).to(dtype).contiguous(memory_format=layout)


def assert_equal_forward_and_backward(operation, expected, tensors, *arguments, **tolerance):
    """Both forms of an operation give the answer and the gradients of what is expected."""
    found = []
    for form in (expected, operation, operation.__wrapped__):
        inputs = [each.clone().requires_grad_() for each in tensors]
        answer = form(*inputs, *arguments)
        (answer * maps(answer.shape, answer.dtype, seed=1)).sum().backward()
        assert answer.dtype == tensors[0].dtype
        found.append([answer, *(each.grad for each in inputs)])
    for others in found[1:]:
        torch.testing.assert_close(others, found[0], **tolerance)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("operation", "expected", "arguments"), CASES)
def test_both_forms_are_pytorchs(operation, expected, arguments, shape, layout):
    for argument in arguments:
        x = maps(shape, layout=layout)
        assert_equal_forward_and_backward(operation, expected, [x], argument)


@pytest.mark.parametrize("shape", SHAPES)
def test_upsampling_in_bfloat16_is_as_exact_as_the_type(shape):
    x = maps(shape, torch.bfloat16)
    assert_equal_forward_and_backward(blocks.enlarge, interpolate, [x], 4, **ROUNDED)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("shape", [(2, 4, 6, 5), (1, 16, 8, 12)])
def test_a_gate_is_a_product_in_either_layout(shape, layout, dtype):
    x = maps(shape, dtype, layout)
    boundary = maps((shape[0], 1, *shape[2:]), dtype, seed=2).abs()
    tolerance = {} if dtype is torch.float32 else ROUNDED
    assert_equal_forward_and_backward(
        blocks.gate, lambda x, b: x * (1 - b), [x, boundary], **tolerance
    )


def test_maxima_of_neighbours_leave_the_pixel_itself_out():
    x = maps((2, 1, 9, 11)).abs()
    windows = F.unfold(x, 5, padding=2).view(-1, 25, 9, 11)
    windows[:, 12] = 0
    assert torch.equal(pooling.neighbour_maxima(x), windows.amax(dim=1, keepdim=True))


def test_the_fast_form_is_that_of_a_cpu_outside_an_exported_graph():
    operation = fast_on_cpu(lambda x, number: x + number)(lambda x, number: x - number)

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
    few, many = (maps((1, count, 4, 4)).requires_grad_() for count in (2, 9))
    assert "EnlargeFew" in type(blocks.upsample(few).grad_fn).__name__
    assert "EnlargeFew" not in type(blocks.upsample(many).grad_fn).__name__
