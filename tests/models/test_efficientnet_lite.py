"""The trunk alone; its features are compared in tests/training/test_imagenet_weights.py."""

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from models.blocks import pad_to_multiple
from models.efficientnet_lite import CHANNELS, WIDTHS, EfficientNetLite


class Features(nn.Module):
    """All features of a picture of any size."""

    def __init__(self, trunk):
        super().__init__()
        self.trunk = trunk

    def forward(self, x):
        at_2, at_4 = self.trunk.early(pad_to_multiple(x, 32))
        return at_2, at_4, *self.trunk.late(at_4)


@pytest.fixture(scope="module")
def trunk():
    torch.manual_seed(0)
    return EfficientNetLite().eval()


def test_features_have_their_strides_and_channels(trunk):
    shapes = [tuple(x.shape) for x in Features(trunk)(torch.zeros(2, 3, 50, 90))]
    assert shapes == [(2, c, 64 // stride, 96 // stride) for stride, c in CHANNELS.items()]


def test_a_fused_start_has_the_same_strides_and_channels_and_no_wide_map_at_stride_2():
    fused = EfficientNetLite((16, 48, 48, *WIDTHS[3:]), fused_start=True).eval()
    shapes = [tuple(x.shape) for x in Features(fused)(torch.zeros(2, 3, 50, 90))]
    assert shapes == [(2, c, 64 // stride, 96 // stride) for stride, c in CHANNELS.items()]
    assert not list(fused.stride2.parameters())
    with pytest.raises(ValueError, match="stem of 16 channels, got 32"):
        EfficientNetLite(fused_start=True)


def test_parameters_and_operations_are_those_of_lite0_without_its_classifier(trunk):
    """Lite0 has 4.652 M and, at 224 x 224, 407 M multiply-accumulates (Liu 2020)."""
    head = 320 * 1280, 2 * 1280, 1280 * 1000 + 1000  # convolution, normalisation, classes
    assert sum(p.numel() for p in trunk.parameters()) == 4_652_008 - sum(head)
    with FlopCounterMode(display=False) as counter:
        Features(trunk)(torch.zeros(1, 3, 224, 224))
    whole = counter.get_total_flops() / 2 + head[0] * 7 * 7 + 1280 * 1000
    assert whole / 1e6 == pytest.approx(407, rel=0.06)


def test_pruned_widths_are_those_of_the_inner_convolutions():
    widths = tuple(width // 2 for width in WIDTHS)
    trunk = EfficientNetLite(widths)
    inner = [m.out_channels for m in trunk.modules() if isinstance(m, nn.Conv2d) and m.groups > 1]
    assert tuple(inner) == widths
    shapes = [x.shape[1] for x in Features(trunk.eval())(torch.zeros(1, 3, 32, 32))]
    assert shapes == list(CHANNELS.values())
    for wrong in (widths[1:], (0, *widths[1:])):
        with pytest.raises(ValueError, match="16 positive widths"):
            EfficientNetLite(wrong)


def test_every_weight_and_what_is_added_at_stride_4_get_a_gradient():
    trunk = EfficientNetLite()
    at_4 = trunk.early(torch.randn(2, 3, 64, 64))[1]
    cues = torch.randn_like(at_4, requires_grad=True)
    sum(x.square().mean() for x in trunk.late(at_4 + cues)).backward()
    assert cues.grad.any()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in trunk.parameters())
    # The prefixes by which a recipe freezes stages.
    parts = {name.partition(".")[0] for name, _ in trunk.named_parameters()}
    assert parts == {"stem", *(f"stride{stride}" for stride in CHANNELS)}
