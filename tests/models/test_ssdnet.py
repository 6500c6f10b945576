"""The networks against the paper's figures and their own promises."""

from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from models import SSDNet, SSDNetConfig, SSDNetLiteConfig, create_model
from models.registry import NETWORKS
from runtime.contract.contract import ClassInfo

# Params and MACs at 125 x 414 of the family, which the paper prints to two digits.
PAPER = {
    "ssdnet": (34.62e6, 33.2e9),
    "ssdnet-sem": (24.78e6, 25.1e9),
    "ssdnet-dep": (24.78e6, 25.1e9),
    "ssdnet-dep-d": (24.78e6, 25.1e9),
    "ssdnet-dep-rgb": (24.78e6, 25.1e9),
}

FAMILY = [
    name
    for name, (_, config) in NETWORKS.items()
    if isinstance(config, SSDNetConfig | SSDNetLiteConfig)
]


def frame(height, width, batch=1, seed=0):
    """Random RGB in 0..255 and a depth map with 5 % of its pixels measured."""
    draw = torch.Generator().manual_seed(seed)
    rgb = torch.rand(batch, 3, height, width, generator=draw) * 255
    depth = torch.rand(batch, 1, height, width, generator=draw) * 80 + 1
    return rgb, depth * (torch.rand(depth.shape, generator=draw) < 0.05)


def macs(model, height, width):
    """Count the multiply-accumulates of a model on the meta device."""
    inputs = torch.empty(1, 3, height, width), torch.empty(1, 1, height, width)
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model(*(each.to("meta") for each in inputs))
    return counter.get_total_flops() / 2


def small(name, **changes):
    """The same structure with few channels, so that tests are quick."""
    config = NETWORKS[name].config
    if widths := getattr(config, "encoder_widths", ()):
        changes |= {"encoder_widths": (8,) * len(widths)}
    else:
        changes |= {
            "encoder_channels": tuple(width // 8 for width in config.encoder_channels),
            "boundary_channels": 4,
        }
    return replace(
        config,
        decoder_channels=tuple(max(width // 8, 4) for width in config.decoder_channels),
        **changes,
    )


def build(name, **changes):
    """A network of `small`."""
    return NETWORKS[name].network(small(name, **changes))


@pytest.mark.parametrize("name", PAPER)
def test_params_and_macs_are_the_papers(name):
    with torch.device("meta"):
        model = create_model(name).eval()
    params, expected_macs = PAPER[name]
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(params, rel=0.03)
    assert macs(model, 125, 414) == pytest.approx(expected_macs, rel=0.03)


def test_lite_stays_within_ten_gmacs_at_512x1024():
    with torch.device("meta"):
        model = create_model("ssdnet-lite").eval()
    assert macs(model, 512, 1024) <= 10e9
    assert model.config.semantic_head
    assert model.config.depth_head


@pytest.mark.parametrize("name", FAMILY)
@pytest.mark.parametrize("size", [(32, 32), (33, 47), (125, 414), (64, 97)])
def test_any_size_of_32_and_more_works(name, size):
    config = small(name)
    output = build(name).eval()(*frame(*size, batch=2))
    assert output.boundary_logits.shape == (2, 1, *size)
    assert (output.semantic_logits is not None) == config.semantic_head
    if config.semantic_head:
        assert output.semantic_logits.shape == (2, 11, *size)
    assert (output.depths is not None) == config.depth_head
    if config.depth_head:
        assert output.depths[0].shape == (2, 1, *size)
        is_lite = isinstance(config, SSDNetLiteConfig)
        assert (output.depth_uncertainty is not None) == is_lite
        assert len(output.depths) == (1 if is_lite else len(config.decoder_channels))
        assert all(((d >= 0) & (d <= 1)).all() for d in output.depths)


def test_paper_grids_round_up():
    output = build("ssdnet").eval()(*frame(125, 414))
    sizes = [(125, 414), (63, 207), (32, 104), (16, 52), (8, 26)]
    assert [tuple(depth.shape[2:]) for depth in output.depths] == sizes


def test_refined_semantics_are_twice_as_fine_as_the_rest():
    model = build("ssdnet-lite").eval()
    coarse = model.predict_coarse(*frame(64, 96))
    assert tuple(coarse.semantic_logits.shape[2:]) == (32, 48)
    assert [tuple(depth.shape[2:]) for depth in coarse.depths] == [(64, 96)]
    assert coarse.boundary_logits.shape == coarse.depth_uncertainty.shape == (1, 1, 64, 96)
    plain = build("ssdnet-lite", semantic_refine_channels=0).eval()
    assert tuple(plain.predict_coarse(*frame(64, 96)).semantic_logits.shape[2:]) == (16, 24)


def test_semantics_may_stay_on_their_own_grid_without_the_padding():
    model = build("ssdnet-lite").eval()
    images = frame(50, 71)
    output = model(*images, upsample_semantic=False)
    coarse = model.predict_coarse(*images).semantic_logits
    assert tuple(output.semantic_logits.shape[2:]) == (25, 36)
    assert torch.equal(output.semantic_logits, coarse[:, :, :25, :36])
    assert tuple(output.boundary_logits.shape[2:]) == (50, 71)


@pytest.mark.parametrize(
    ("rgb", "depth", "message"),
    [
        ((1, 3, 31, 64), (1, 1, 31, 64), "at least 32"),
        ((1, 3, 64, 31), (1, 1, 64, 31), "at least 32"),
        ((1, 32, 64, 3), (1, 1, 32, 64), r"rgb must be \(N, 3, H, W\)"),
        ((1, 3, 32, 64), (1, 1, 32, 63), "sparse_depth must be"),
    ],
)
def test_wrong_shapes_are_refused(rgb, depth, message):
    with pytest.raises(ValueError, match=message):
        build("ssdnet-lite")(torch.zeros(rgb), torch.zeros(depth))


@pytest.mark.parametrize("name", ["ssdnet", "ssdnet-lite"])
def test_invalid_depth_counts_as_none(name):
    model = build(name).eval()
    rgb, depth = frame(64, 96)
    empty = depth == 0
    spoiled = depth.clone()
    values = torch.tensor([float("nan"), float("inf"), -float("inf"), -3.0, 250.5, 1e30])
    spoiled[empty] = values.repeat(int(empty.sum()) // len(values) + 1)[: int(empty.sum())]
    clean, same = model(rgb, depth), model(rgb, spoiled)
    torch.testing.assert_close(same.semantic_logits, clean.semantic_logits, rtol=0, atol=0)
    torch.testing.assert_close(same.depths[0], clean.depths[0], rtol=0, atol=0)


@pytest.mark.parametrize("name", ["ssdnet", "ssdnet-lite"])
def test_empty_depth_gives_finite_answers_and_gradients(name):
    model = build(name).train()
    rgb, depth = frame(64, 96, batch=2)
    output = model(rgb, torch.zeros_like(depth))
    (output.depths[0].mean() + output.semantic_logits.mean()).backward()
    assert torch.isfinite(output.depths[0]).all()
    gradients = [p.grad for p in model.parameters() if p.grad is not None]
    assert gradients
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.parametrize(
    ("name", "uses_rgb", "uses_depth"),
    [("ssdnet-dep", True, True), ("ssdnet-dep-d", False, True), ("ssdnet-dep-rgb", True, False)],
)
def test_variants_look_only_at_their_inputs(name, uses_rgb, uses_depth):
    model = build(name).eval()
    rgb, depth = frame(64, 96)
    base = model(rgb, depth).depths[0]
    assert torch.equal(model(255 - rgb, depth).depths[0], base) != uses_rgb
    assert torch.equal(model(rgb, depth * 0.5).depths[0], base) != uses_depth


def test_normalisation_takes_0_to_255():
    """A frame of the mean colour is zero to the first convolution."""
    model = build("ssdnet").eval()
    seen = {}
    model.encoder.register_forward_pre_hook(lambda _, args: seen.update(x=args[0]))
    mean = model.rgb_mean.expand(1, 3, 32, 32)
    model(mean + model.rgb_std, torch.full((1, 1, 32, 32), 25.0))
    torch.testing.assert_close(seen["x"][:, :3], torch.ones(1, 3, 32, 32))
    torch.testing.assert_close(seen["x"][:, 3:], torch.full((1, 1, 32, 32), 0.25))


def test_batch_is_the_same_as_one_by_one():
    model = build("ssdnet-lite").eval()
    rgb, depth = frame(45, 70, batch=3)
    together = model(rgb, depth).semantic_logits
    apart = torch.cat([model(rgb[i : i + 1], depth[i : i + 1]).semantic_logits for i in range(3)])
    torch.testing.assert_close(together, apart, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"semantic_head": False, "classes": (), "depth_head": False}, "a semantic head, a depth"),
        ({"use_rgb": False, "use_sparse_depth": False}, "rgb, sparse depth or both"),
        ({"classes": ()}, "exactly when"),
        ({"decoder_channels": (8, 8)}, "per skip \\(5\\)"),
        ({"encoder_blocks": (1, 1)}, "same length"),
        ({"max_depth_m": 0.0}, "max_depth_m must be 1 to 10000"),
        ({"name": "a\nb"}, "name must be printable"),
        ({"classes": (ClassInfo("\ud800", (0, 0, 0)),)}, r"classes\[0\].name"),
    ],
)
def test_invalid_configurations_are_refused_with_the_reason(changes, text):
    with pytest.raises(ValueError, match=text):
        SSDNet(SSDNetConfig(**changes))


@pytest.mark.parametrize(
    ("name", "gating"),
    [
        ("ssdnet", True),
        ("ssdnet", False),
        ("ssdnet-small", True),
        ("ssdnet-small", False),
        ("ssdnet-lite", True),
    ],
)
def test_only_gated_decoders_depend_on_the_boundary(name, gating):
    model = build(name, **({"boundary_gating": gating} if name != "ssdnet-lite" else {})).eval()
    if name == "ssdnet-lite":  # a new one answers with the base
        torch.nn.init.normal_(model.surface_depth.head.weight)
    inputs = frame(64, 96)
    free = model(*inputs)
    for side in model.boundary_decoder.sides:
        side[1].bias.data.add_(3.0)
    bound = model(*inputs)
    assert not torch.equal(free.boundary_logits, bound.boundary_logits)
    assert torch.equal(free.semantic_logits, bound.semantic_logits) != gating
    assert torch.equal(free.depths[0], bound.depths[0]) != gating


def test_depth_gain_multiplies_the_sparse_depth_only():
    plain, strong = (build("ssdnet-small", sparse_depth_gain=g).eval() for g in (1.0, 20.0))
    strong.load_state_dict(plain.state_dict())
    rgb, depth = frame(64, 96)
    assert torch.equal(plain(rgb, depth * 0).depths[0], strong(rgb, depth * 0).depths[0])
    answer = strong(rgb, depth).depths[0]
    assert not torch.equal(plain(rgb, depth).depths[0], answer)
    plain.stem[0][0].weight.data[:, 3] *= 20.0  # the depth is the fourth channel
    torch.testing.assert_close(plain(rgb, depth).depths[0], answer)
