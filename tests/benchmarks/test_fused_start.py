"""A fused start learns the features of another one."""

from itertools import repeat

import torch

from fused_start import learn_start, unexplained
from models.efficientnet_lite import WIDTHS, EfficientNetLite


def test_the_start_alone_learns(capsys):
    torch.manual_seed(0)
    teacher = EfficientNetLite()  # in training its features have a variance of 1
    student = EfficientNetLite((16, 48, 48, *WIDTHS[3:]), fused_start=True)
    late = student.stride8[0].expand[0].weight.clone()
    rgb = torch.rand(2, 3, 32, 64) * 2 - 1

    def error():
        with torch.no_grad():
            return float(unexplained(student.train().early(rgb)[1], teacher.early(rgb)[1]))

    before = error()
    learn_start(student, teacher, repeat(rgb), 60, lambda images: images)
    assert error() < 0.4 * before
    assert torch.equal(student.stride8[0].expand[0].weight, late)
    assert capsys.readouterr().out.startswith("60 steps: stride 2 ")
