"""Other people's networks: their size and work as they are known, and their exported files."""

import re

import pytest
import torch
from torch import nn
from torch.nn import functional as F
from torch.utils.flop_counter import FlopCounterMode

from export.exporter import export_checkpoint
from export.probe_frames import probe_frames
from models import create_model, save_checkpoint
from models.baselines import (
    bacnn,
    deeplab_largefov,
    fast_scnn,
    fcn8s,
    sparse_to_dense,
    vgg16,
)
from models.baselines.espnet import SpatialPyramid
from models.baselines.max_unpooling import max_mask, max_unpool
from models.baselines.sparse_conv import SparseConv
from models.blocks import adaptive_mean
from models.classes import numbered_classes
from models.registry import NETWORKS

SMALL, THIRD = (128, 416), (125, 414)
# Parameters and multiply-accumulates at a size (height, width), with 19 classes. Some are known to
# two digits alone, and for some nothing but the parameters.
KNOWN = {
    "bacnn": (149.1e6, 38.6e9, THIRD),
    "ddrnet-23-slim": (5.70e6, 0.92e9, SMALL),
    "deeplab-largefov": (20.5e6, None, SMALL),
    "enet": (0.36e6, 0.41e9, SMALL),
    "erfnet": (2.07e6, 2.70e9, SMALL),
    "espnet": (0.364e6, 0.48e9, SMALL),
    "fast-scnn": (1.14e6, 0.17e9, SMALL),
    "fcn8s": (134.4e6, 22.4e9, THIRD),
    "sparse-conv": (25.6e3, None, SMALL),
    "sparse-to-dense": (11.7e6, 2.04e9, SMALL),
}
# What makes their exports quick: fewer layers and channels, of the same kinds.
VGG = ((16, 1), (16, 1), (256, 1), (512, 1), (512, 1))
SMALLER = (
    *((module, "VGG16_BLOCKS", VGG) for module in (vgg16, bacnn, deeplab_largefov)),
    *((module, "_WIDE", 64) for module in (fcn8s, deeplab_largefov)),
    (fast_scnn, "_POOLED_SIZES", (3,)),
    (sparse_to_dense, "_STAGES", (8, 16, 32, 64)),
)


def has_classes(name):
    return bool(NETWORKS[name].config.classes)


def build(name):
    return create_model(name, **({"classes": numbered_classes(19)} if has_classes(name) else {}))


@pytest.mark.parametrize("name", KNOWN)
def test_params_and_macs_are_the_known_ones(name):
    params, macs, (height, width) = KNOWN[name]
    with torch.device("meta"):
        model = build(name).eval()
        frame = torch.empty(1, 3, height, width), torch.empty(1, 1, height, width)
        with FlopCounterMode(display=False) as counter:
            model(*frame)
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(params, rel=0.015)
    if macs is not None:
        assert counter.get_total_flops() / 2 == pytest.approx(macs, rel=0.015)


def test_espnet_can_have_fewer_classes_than_dilations():
    with torch.device("meta"):
        block = SpatialPyramid(8, 2)
        assert block(torch.empty(1, 8, 16, 32)).shape == (1, 2, 16, 32)


def kind_of(block):
    """Describe the layers of a block without its numbers of channels, groups and dilations."""
    return re.sub(r"\(\d+(, \d+)?|(padding|dilation)=\(\d+, \d+\)|groups=\d+", "(", repr(block))


def shorten(network):
    """Skip every block that keeps its input's shape if there is another of its kind before.

    Batch norms are such blocks too: one is left.
    """
    kinds, repeated = set(), []

    def look(block, inputs, output):
        has_parts = next(block.children(), None) is not None
        if not has_parts and not isinstance(block, nn.BatchNorm2d):
            return
        kind = kind_of(block)
        if kind in kinds and len(inputs) == 1 and inputs[0].shape == output.shape:
            repeated.append(block)
        kinds.add(kind)

    names = {part: name for name, part in network.named_modules() if name}
    hooks = [part.register_forward_hook(look) for part in names]
    network.eval()(torch.zeros(1, 3, 65, 98), torch.zeros(1, 1, 65, 98))
    for hook in hooks:
        hook.remove()
    for block in repeated:
        network.set_submodule(names[block], nn.Identity())


# Exported for any size, which takes longer to trace: each has another way down and up again.
ANY_SIZE = ("enet", "fast-scnn", "fcn8s")


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_exports_at_an_odd_size(name, tmp_path, monkeypatch):
    for module, constant, value in SMALLER:
        monkeypatch.setattr(module, constant, value)
    entry = NETWORKS[name]

    class Short(entry.network):
        def __init__(self, config):
            super().__init__(config)
            shorten(self)

    monkeypatch.setitem(NETWORKS, name, entry._replace(network=Short))
    torch.manual_seed(0)
    model = build(name).train()
    frames = probe_frames((64, 96), max_depth_m=100.0)[:4]  # without faults
    rgb = torch.stack([torch.from_numpy(f.rgb).permute(2, 0, 1).float() for f in frames])
    sparse_depth = torch.stack([torch.from_numpy(f.sparse_depth)[None] for f in frames])
    with torch.no_grad():
        for _ in range(5):  # batch statistics of frames
            output = model(rgb, sparse_depth)
        # Answers that vary, depths within the range.
        if has_classes(name):
            model.semantic_head.weight /= output.semantic_logits.std()
        else:
            if isinstance(model.depth_head, nn.Conv2d):
                model.depth_head.weight *= 0.1 / output.depths[0].std()
                output = model(rgb, sparse_depth)
            model.depth_head.bias += 0.5 - output.depths[0].mean()
    save_checkpoint(tmp_path / "c.pt", model)
    report = export_checkpoint(
        tmp_path / "c.pt",
        tmp_path / "m.onnx",
        size=(65, 98),
        dynamic=name in ANY_SIZE,
        with_logits=has_classes(name),
    )
    heads = model.heads
    assert report.heads == (*heads, "semantic_logits") if has_classes(name) else heads
    # On empty, full and faulty depth maps too, and if it takes any size on the smallest.
    assert all(head.passed for head in report.parity.values())


@pytest.mark.parametrize("size", [(4, 13), (1, 1), (7, 5)])
@pytest.mark.parametrize("cells", [1, 2, 3, 6])
def test_adaptive_mean_is_adaptive_average_pooling(size, cells):
    x = torch.randn(2, 3, *size, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(adaptive_mean(x, cells), F.adaptive_avg_pool2d(x, cells))


@pytest.mark.parametrize("name", ["sparse-conv", "sparse-to-dense"])
def test_an_empty_lidar_frame_has_finite_depths_within_the_range(name):
    torch.manual_seed(0)
    model = create_model(name).eval()
    rgb = 255 * torch.rand(1, 3, 45, 70)
    for sparse_depth in (torch.zeros(1, 1, 45, 70), torch.full((1, 1, 45, 70), 90.0)):
        with torch.no_grad():
            depth = model(rgb, sparse_depth).depths[0]
        assert depth.shape == (1, 1, 45, 70)
        assert depth.isfinite().all()
        assert depth.min() >= 0
        assert depth.max() <= 1


def test_lidar_alone_is_read():
    torch.manual_seed(0)
    model = create_model("sparse-conv").train()
    sparse_depth = 100 * (torch.rand(1, 1, 40, 64) < 0.1) * torch.rand(1, 1, 40, 64)
    dark, bright = (model(torch.full((1, 3, 40, 64), v), sparse_depth) for v in (0.0, 255.0))
    assert torch.equal(dark.depths[0], bright.depths[0])
    # Six layers of means with weights made for sums would leave nothing to learn from.
    assert dark.depths[0].std() > 0.01


def test_max_unpooling_is_that_of_pytorch():
    x = torch.randn(2, 3, 6, 8, generator=torch.Generator().manual_seed(0))
    x[0, 0] = 0.0  # all equal: the first
    x[1, 1, :, ::2] = x[1, 1, :, 1::2]
    pooled, indices = F.max_pool2d(x, 2, return_indices=True)
    assert torch.equal(max_unpool(pooled, max_mask(x)), F.max_unpool2d(pooled, indices, 2))


def test_rounding_does_not_move_a_maximum():
    x = torch.ones(1, 1, 2, 2)
    x[0, 0, 1, 1] += 1e-6
    assert max_mask(x)[0, 0, :, 0, 0].tolist() == [True, False, False, False]


def test_a_sparse_convolution_is_the_mean_of_what_was_measured():
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(1, 1, 9, 11, generator=generator)
    mask = (torch.rand(1, 1, 9, 11, generator=generator) < 0.1).float()
    layer = SparseConv(1, 1, kernel=3)
    torch.nn.init.constant_(layer.bias, 0.25)
    with torch.no_grad():
        answer, grown = layer(x, mask)
    kernel = layer.conv.weight[0, 0].detach()
    for row in range(9):
        for column in range(11):
            total, count = 0.0, 0
            for i in range(3):
                for j in range(3):
                    y, z = row + i - 1, column + j - 1
                    if 0 <= y < 9 and 0 <= z < 11 and mask[0, 0, y, z]:
                        total, count = total + float(kernel[i, j] * x[0, 0, y, z]), count + 1
            # The sum over the share of a full window: 9 times the mean.
            expected = 0.25 + (9 * total / count if count else 0.0)
            assert float(answer[0, 0, row, column]) == pytest.approx(expected, abs=1e-5)
            assert float(grown[0, 0, row, column]) == (count > 0)


def test_boundaries_gate_every_block_of_bacnn(monkeypatch):
    """If everything is boundary, the image has no effect."""
    monkeypatch.setattr(fcn8s, "_WIDE", 16)
    torch.manual_seed(0)
    model = create_model("bacnn", classes=numbered_classes(4)).eval()
    pictures = 255 * torch.rand(2, 3, 33, 47)
    open_, shut = {}, {}
    with torch.no_grad():
        for bias, found in ((-50.0, open_), (50.0, shut)):
            torch.nn.init.zeros_(model.boundary.fuse.weight)
            torch.nn.init.constant_(model.boundary.fuse.bias, bias)
            output = model(pictures, torch.zeros(2, 1, 33, 47))
            found["logits"] = output.semantic_logits
    assert not torch.allclose(open_["logits"][0], open_["logits"][1])
    torch.testing.assert_close(shut["logits"][0], shut["logits"][1])


def test_few_scores_of_many_channels_are_computed_in_single_precision(monkeypatch):
    """Their gradient in bfloat16 ends the process, see `FCN8s.score`."""
    monkeypatch.setattr(fcn8s, "_WIDE", 16)
    model = create_model("fcn8s", classes=numbered_classes(4))
    dtypes = []
    model.semantic_head.register_forward_hook(lambda *call: dtypes.append(call[-1].dtype))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        output = model(torch.rand(2, 3, 33, 47), torch.zeros(2, 1, 33, 47))
    output.semantic_logits.sum().backward()
    assert dtypes == [torch.float32]
